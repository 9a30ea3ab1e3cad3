"""Predictive coder: the ranges of returns, in about 6.1 bit a return lossless and 2.8 within a centimetre on KITTI.

A range is coded as its difference from the last one of its row. What is likely is the sum of what fourteen small
contexts have learned: where the returns around lie as seen from the last one, measured by how much ranges differ here.
There are no weights: all is learned in the frame itself, or goes on from the frame before. The format is
docs/wire-format-predictive.md; `reference.predictive` is the same in plain Python.

>>> from lidarcodec.sensor_model import Calibration, SensorModel
>>> sensor = SensorModel("HDL-64E S2", Calibration.from_values({"vert_correction_rad": np.linspace(0.03, -0.43, 64)}))
>>> ranges = (5000 + np.arange(64 * 10) % 50).astype(np.uint16).reshape(64, 10)
>>> returns, fired, levels = ranges > 5006, np.ones((2, 10), bool), np.zeros(64, np.int32)
>>> data = PredictiveCoder().encode(ranges, returns, fired, sensor, 1, levels)
>>> came = PredictiveCoder().decode(data, returns, fired, sensor, 1, levels)
>>> bool((came == np.where(returns, ranges, 0)).all())
True
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.fast import NativeNets
from lidarcodec.entropy.intensity_coder import check_returns
from lidarcodec.entropy.mask_coder import as_bytes, columns_of, frame_geometry
from lidarcodec.entropy.net_trainer import ReturnSamples
from lidarcodec.errors import SectionError
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import LASERS

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]

FIRINGS: Final = 24
"""After so many firings the sensor's errors come again: they have periods of 3, 12, 2.4 and 24 firings."""
_WHOLE: Final = -1


class KnownColumns(NamedTuple):
    """Columns to the left of a slab, K of them, which both ends know.

    ranges: (64, K) uint16, 0 = no return; fired: (2, K) bool; expected: (64, K) uint16, what was expected, 0 = nothing
    """

    ranges: Ranges
    fired: Mask
    expected: Ranges

    @classmethod
    def none(cls) -> KnownColumns:
        """No columns."""
        nothing = np.zeros((LASERS, 0), np.uint16)
        return cls(nothing, np.zeros((2, 0), np.bool_), nothing)

    def last(self, columns: int) -> KnownColumns:
        """The last ones of them, at most so many."""
        first = max(self.ranges.shape[1] - columns, 0)
        return KnownColumns(self.ranges[:, first:], self.fired[:, first:], self.expected[:, first:])

    def and_then(self, other: KnownColumns) -> KnownColumns:
        """These columns, and others to their right."""
        return KnownColumns(*(np.hstack(both) for both in zip(self, other, strict=True)))


def known_columns(data: bytes) -> int | None:
    """How many columns the bytes of a slab need to be known; None for a whole frame, and for no returns.

    Raises TruncatedError.
    """
    known = _native.known_columns(data)
    return None if known == _WHOLE else known


class PredictiveCoder:
    """Codes the ranges of one frame after another; what one taught stays for the next, until `reset`.

    A decoder has to see the same frames as the encoder since the last `reset`. After an error only `reset` helps.
    path: how it computes, one of `coding_paths`; by default the quickest. Bytes do not depend on it.
    nets: networks that say what is likely to begin with, as codec `riddle` has them; a decoder needs the same
    at_once: whether two threads code halves; None: if they are large and a processor is free
    """

    def __init__(self, path: str = "", nets: NativeNets | None = None, at_once: bool | None = None) -> None:
        self._native = _native.PredictiveCoder(path, None if nets is None else nets.native, at_once)

    def copy(self) -> PredictiveCoder:
        """Another one, which goes on from the same state."""
        other = PredictiveCoder.__new__(PredictiveCoder)
        other._native = self._native.copy()
        return other

    def reset(self) -> None:
        """Forget everything."""
        self._native.reset()

    def change(self, nets: NativeNets) -> None:
        """Go on with other networks, where there were some; what contexts learned stays."""
        self._native.change(nets.native)

    def encode(
        self,
        ranges: npt.NDArray[np.uint16],
        returns: npt.NDArray[np.bool_],
        fired: npt.NDArray[np.bool_],
        sensor: SensorModel,
        step: int,
        levels: npt.NDArray[np.int32],
        *,
        turn: int | None = None,
        firing: int = 0,
        expected: npt.NDArray[np.uint16] | None = None,
        slab_after: KnownColumns | None = None,
        samples: ReturnSamples | None = None,
        quick: bool = False,
        sent: npt.NDArray[np.uint16] | None = None,
        halves: bool = False,
    ) -> bytes:
        """Bytes of the ranges of the cells set in `returns`; 9 ms for 120,000 of them, less in longer steps.

        ranges: (64, W) uint16, range steps; returns: (64, W) bool, which decoding needs; fired: (2, W) bool
        step: odd, range steps in a cell; levels: (64,) int32, what is added to each row, 0 to 1000 range steps
        turn: columns in a full turn (`columns_in_turn`), 1 to 65535; by default found from the returns
        firing: how many columns the sensor fired before this frame, as far as it can be told (`ranges/firings.py`)
        expected: (64, W) uint16, what to expect, 0 where nothing; decoding needs it; 3 ms more
        samples: takes some of the returns to train a network on, where there is one
        quick: with fewer contexts, where there is no network: three tenths less time, up to 0.03 bits a return more
        sent: (64, W) uint16 of zeros, takes the ranges that a decoder gets. With it ranges are free: of all within half
            a step the encoder takes those that cost least; without it they are rounded to whole cells
        halves: of a whole frame that goes on from others: upper and lower rows get models of their own, so that two
            cores can code them

        Raises SectionError if shapes do not fit, a return has no range, or a half that did not fire has a return.
        """
        check_returns(returns, fired)
        columns = columns_of(turn)
        if firing < 0:
            raise SectionError(f"firings are counted from 0: {firing}")
        if ranges.dtype != np.uint16 or ranges.shape != returns.shape:
            raise SectionError(f"ranges are {ranges.dtype}{ranges.shape}, not uint16{returns.shape}")
        expected, known = _expectation(expected, returns), _WHOLE
        if sent is not None and (sent.dtype != np.uint16 or sent.shape != returns.shape):
            raise SectionError(f"what is sent is {sent.dtype}{sent.shape}, not uint16{returns.shape}")
        into = np.zeros((LASERS, 0), np.uint16) if sent is None else sent
        if slab_after is not None:
            known = slab_after.ranges.shape[1]
            if sent is not None:
                into = np.zeros((LASERS, known + returns.shape[1]), np.uint16)
            ranges = np.hstack([slab_after.ranges, ranges])
            returns, fired, expected = _with(slab_after, returns, fired, expected)
        given = (np.ascontiguousarray(ranges), as_bytes(returns), step, _levels(levels), *frame_geometry(fired, sensor))
        drawn = None if samples is None else samples.native
        data = self._native.encode(*given, columns, firing % FIRINGS, expected, known, drawn, quick, into, halves)
        if sent is not None and into is not sent:
            sent[:] = into[:, known:]
        return data

    def decode(
        self,
        data: bytes,
        returns: npt.NDArray[np.bool_],
        fired: npt.NDArray[np.bool_],
        sensor: SensorModel,
        step: int,
        levels: npt.NDArray[np.int32],
        *,
        expected: npt.NDArray[np.uint16] | None = None,
        slab_after: KnownColumns | None = None,
    ) -> npt.NDArray[np.uint16]:
        """(64, W) uint16 ranges within half a step of what they were, 0 outside of `returns`.

        All else as the encoder was given. Raises SectionError or TruncatedError.
        """
        check_returns(returns, fired)
        seen, known, before = _expectation(expected, returns), _WHOLE, KnownColumns.none().ranges
        if slab_after is not None:
            before = np.ascontiguousarray(slab_after.ranges)
            known = before.shape[1]
            returns, fired, seen = _with(slab_after, returns, fired, seen)
        given = (data, as_bytes(returns), step, _levels(levels), *frame_geometry(fired, sensor), seen)
        image = self._native.decode(*given, known, before)
        return image if slab_after is None else image[:, before.shape[1] :]


def _levels(levels: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    if levels.dtype != np.int32 or levels.shape != (LASERS,):
        raise SectionError(f"levels are {levels.dtype}{levels.shape}, not int32({LASERS},)")
    return np.ascontiguousarray(levels)


def _expectation(expected: npt.NDArray[np.uint16] | None, returns: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint16]:
    if expected is None:
        return np.zeros((LASERS, 0), np.uint16)
    if expected.dtype != np.uint16 or expected.shape != returns.shape:
        raise SectionError(f"expected ranges are {expected.dtype}{expected.shape}, not uint16{returns.shape}")
    return np.ascontiguousarray(expected)


def _with(known: KnownColumns, returns: Mask, fired: Mask, expected: Ranges) -> tuple[Mask, Mask, Ranges]:
    """What is known of a slab with the columns before it."""
    if expected.shape[1]:
        expected = np.ascontiguousarray(np.hstack([known.expected, expected]))
    return np.hstack([known.ranges != 0, returns]), np.hstack([known.fired, fired]), expected
