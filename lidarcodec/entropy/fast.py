"""The native coders, with their types; nobody else of this package touches the extension module.

Each has a pure-Python twin that gives the same bytes: `reference`, `reference.mask`, `reference.keep`,
`reference.azimuth`, `reference.intensity`, `reference.predictive`, `reference.series`; of `plane_coder` there is a
decoder, `reference.planes`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy.net_trainer import ReturnSamples
from lidarcodec.entropy.number_series import Form, Line, Series, unzigzag, zigzag
from lidarcodec.units import LASERS

_Number = TypeVar("_Number", np.uint64, np.int64)


def encode_numbers(streams: Sequence[npt.NDArray[np.uint64]]) -> bytes:
    """Bytes of several streams of whole numbers, (N,) uint64 each, small ones cheap; each stream learns by itself."""
    return _encoded(np.concatenate([np.zeros(0, np.uint64), *streams]), map(len, streams))


def encode_signed(streams: Sequence[Series]) -> bytes:
    """The same of numbers with a sign, (N,) int64 each, folded by `zigzag`."""
    return _encoded(zigzag(np.concatenate([np.zeros(0, np.int64), *streams])), map(len, streams))


def _encoded(values: npt.NDArray[np.uint64], counts: Iterable[int]) -> bytes:
    return _native.encode_numbers(values, np.array(list(counts), np.uint64))


def decode_numbers(data: bytes, counts: Sequence[int]) -> list[npt.NDArray[np.uint64]]:
    """Streams of `counts` numbers, (N,) uint64 each.

    Raises SectionError or TruncatedError. Takes 8 bytes a number: check the counts before.
    """
    return _split(_native.decode_numbers(data, np.array(counts, np.uint64)), counts)


def decode_signed(data: bytes, counts: Sequence[int]) -> list[Series]:
    """The same of numbers with a sign, (N,) int64 each."""
    return _split(unzigzag(_native.decode_numbers(data, np.array(counts, np.uint64))), counts)


def _split(values: npt.NDArray[_Number], counts: Sequence[int]) -> list[npt.NDArray[_Number]]:
    ends = accumulate(counts)
    return [values[end - count : end] for end, count in zip(ends, counts, strict=True)]


class Fit(NamedTuple):
    """A form of a series, its line, the (N,) residuals, and about what they cost in 256ths of a bit."""

    form: Form
    line: Line
    left: Series
    cost: int


def best_form(values: Series, modulus: int = 0) -> Fit:
    """Form and line that leave the cheapest residuals of (N,) int64; these are centred if a modulus is given."""
    form, level, rate, left, cost = _native.best_form(values, modulus)
    return Fit(Form(form), Line(level, rate), left, cost)


def best_period(types: npt.NDArray[np.uint8], longest: int) -> int:
    """Period, 1 to `longest`, that predicts most of (N,) types by those one period before; `longest` is at most 32."""
    return _native.best_period(types, longest)


def encode_mask(
    mask: npt.NDArray[np.bool_],
    fired: npt.NDArray[np.bool_],
    half: npt.NDArray[np.uint8],
    rotation: npt.NDArray[np.int32],
    earlier: npt.NDArray[np.bool_],
    turn: int,
) -> bytes:
    """Bytes of a (64, W) mask; see `mask_coder`. half, rotation: (64,); earlier: (64, 0): none; turn 0: find it."""
    arrays = (mask.view(np.uint8), fired.view(np.uint8), half, rotation, earlier.view(np.uint8))
    return _native.encode_mask(*arrays, turn)


def decode_mask(
    data: bytes,
    fired: npt.NDArray[np.bool_],
    half: npt.NDArray[np.uint8],
    rotation: npt.NDArray[np.int32],
    earlier: npt.NDArray[np.bool_],
) -> npt.NDArray[np.bool_]:
    """(64, W) bool. Raises SectionError or TruncatedError."""
    return _native.decode_mask(data, fired.view(np.uint8), half, rotation, earlier.view(np.uint8)).view(np.bool_)


def encode_keep(
    keep: npt.NDArray[np.bool_],
    azimuth: npt.NDArray[np.uint16],
    fired: npt.NDArray[np.bool_],
    half: npt.NDArray[np.uint8],
    rotation: npt.NDArray[np.int32],
    earlier: npt.NDArray[np.bool_],
) -> bytes:
    """Bytes of a (64, W) keep mask of few cells; see `keep_coder`. half, rotation: (64,); earlier: (64, 0): none."""
    arrays = (keep.view(np.uint8), azimuth, fired.view(np.uint8), half, rotation, earlier.view(np.uint8))
    return _native.encode_keep(*arrays)


def decode_keep(
    data: bytes,
    azimuth: npt.NDArray[np.uint16],
    fired: npt.NDArray[np.bool_],
    half: npt.NDArray[np.uint8],
    rotation: npt.NDArray[np.int32],
    earlier: npt.NDArray[np.bool_],
) -> npt.NDArray[np.bool_]:
    """(64, W) bool. Raises SectionError or TruncatedError."""
    return _native.decode_keep(data, azimuth, fired.view(np.uint8), half, rotation, earlier.view(np.uint8)).view(
        np.bool_
    )


def encode_intensity(
    values: npt.NDArray[np.uint8],
    returns: npt.NDArray[np.bool_],
    fired: npt.NDArray[np.bool_],
    half: npt.NDArray[np.uint8],
    rotation: npt.NDArray[np.int32],
    turn: int,
) -> bytes:
    """Bytes of (64, W) intensities; see `intensity_coder`. half, rotation: (64,); turn 0: find it."""
    arrays = (values, returns.view(np.uint8), fired.view(np.uint8), half, rotation)
    return _native.encode_intensity(*arrays, turn)


def choose_levels(
    values: npt.NDArray[np.uint8],
    returns: npt.NDArray[np.bool_],
    fired: npt.NDArray[np.bool_],
    half: npt.NDArray[np.uint8],
    rotation: npt.NDArray[np.int32],
    levels: int,
) -> npt.NDArray[np.uint8]:
    """(64, W) uint8, at most `levels` values at the returns, 0 elsewhere. half, rotation: (64,)."""
    arrays = (values, returns.view(np.uint8), fired.view(np.uint8), half, rotation)
    return _native.choose_levels(*arrays, levels)


def decode_intensity(
    data: bytes,
    returns: npt.NDArray[np.bool_],
    fired: npt.NDArray[np.bool_],
    half: npt.NDArray[np.uint8],
    rotation: npt.NDArray[np.int32],
) -> npt.NDArray[np.uint8]:
    """(64, W) uint8. Raises SectionError or TruncatedError."""
    return _native.decode_intensity(data, returns.view(np.uint8), fired.view(np.uint8), half, rotation)


def coding_paths() -> list[str]:
    """How the processor at hand can compute (`plain`, `sse2` or `neon`, `avx2`), the quickest last: the same bytes."""
    return _native.coding_paths()


def net_forms() -> list[str]:
    """How the processor at hand can run networks, the quickest last: the same odds.

    `plain`; on x86-64 `sse2`, `avx2`, `avx512vnni`; on 64-bit ARM `neon`, `dotprod`.
    """
    return _native.net_forms()


MaskView = tuple[
    npt.NDArray[np.uint16],
    npt.NDArray[np.uint8],
    npt.NDArray[np.int32],
    npt.NDArray[np.uint16],
    npt.NDArray[np.int32],
]
"""Azimuth and fired (2, W), beams (6, 64), expected ranges (64, W) or (64, 0) for nothing, motion (12,)."""


class NativeMaskStream:
    """Masks, frame after frame; see `mask_stream`."""

    def __init__(self) -> None:
        self._stream = _native.MaskStream()

    def forget(self) -> None:
        """Forget everything."""
        self._stream.forget()

    def encode(self, mask: npt.NDArray[np.uint8], view: MaskView) -> bytes:
        """Bytes of a (64, W) mask. Raises SectionError."""
        return self._stream.encode(mask, *view)

    def decode(self, data: bytes, view: MaskView) -> npt.NDArray[np.uint8]:
        """(64, W). Raises SectionError or TruncatedError."""
        return self._stream.decode(data, *view)


GivenLayer = tuple[npt.NDArray[np.int16], npt.NDArray[np.int32], int, npt.NDArray[np.int8]]
"""Weights (out, in), biases (out,), shift."""


class NativeNets:
    """Networks of codec `riddle`: of frames alone, of frames that expect something, or both. form: of `net_forms`."""

    def __init__(self, form: str = "") -> None:
        self.native, self._form = _native.RiddleNets(), form

    def add(self, layers: Sequence[GivenLayer]) -> None:
        """Takes a network of three layers. Raises SectionError."""
        first, second, third = layers
        self.native.set(*first, *second, *third, self._form)

    def run(self, inputs: npt.NDArray[np.int8]) -> npt.NDArray[np.int16]:
        """(n, 32) log odds of (n, 72 or 112) inputs. Raises SectionError."""
        return self.native.run(inputs)


Samples = tuple[npt.NDArray[np.int8], npt.NDArray[np.uint8], npt.NDArray[np.uint8]]


def riddle_samples(
    ranges: npt.NDArray[np.uint16],
    returns: npt.NDArray[np.bool_],
    step: int,
    levels: npt.NDArray[np.int32],
    fired: npt.NDArray[np.bool_],
    half: npt.NDArray[np.uint8],
    rotation: npt.NDArray[np.int32],
    turn: int,
    expected: npt.NDArray[np.uint16],
    share: int,
    seed: int,
) -> Samples:
    """Inputs (n, 72 or 112), leaves (n,), first three offset bits (n, 3), 255: none, of a share of the returns."""
    geometry = (fired.view(np.uint8), half, rotation)
    given = (ranges, returns.view(np.uint8), step, levels, *geometry, turn, expected, share, seed)
    return _native.riddle_samples(*given)


def known_columns(data: bytes) -> int:
    """Columns that a slab needs to be known, -1 for a whole frame. Raises TruncatedError."""
    return _native.known_columns(data)


class NativePredictiveCoder:
    """Ranges, frame after frame; see `predictive_coder`. half, rotation, levels: (64,).

    turn 0: find it; expected: (64, W), or (64, 0): nothing; path: one of `coding_paths`, by default the quickest.
    nets: what to code with, if anything
    """

    def __init__(self, path: str = "", nets: NativeNets | None = None) -> None:
        self._coder = _native.PredictiveCoder(path, None if nets is None else nets.native)

    def reset(self) -> None:
        """Forget everything."""
        self._coder.reset()

    def change(self, nets: NativeNets) -> None:
        """Go on with other networks. Raises SectionError where there were none."""
        self._coder.change(nets.native)

    def encode(
        self,
        ranges: npt.NDArray[np.uint16],
        returns: npt.NDArray[np.bool_],
        step: int,
        levels: npt.NDArray[np.int32],
        fired: npt.NDArray[np.bool_],
        half: npt.NDArray[np.uint8],
        rotation: npt.NDArray[np.int32],
        turn: int,
        firing: int,
        expected: npt.NDArray[np.uint16],
        known: int,
        samples: ReturnSamples | None = None,
        quick: bool = False,
        sent: npt.NDArray[np.uint16] | None = None,
    ) -> bytes:
        """Bytes of (64, W) ranges. sent: (64, W), takes free ranges as they are decoded. Raises SectionError."""
        geometry = (fired.view(np.uint8), half, rotation)
        into = np.zeros((LASERS, 0), np.uint16) if sent is None else sent
        given = (ranges, returns.view(np.uint8), step, levels, *geometry, turn, firing, expected, known)
        return self._coder.encode(*given, None if samples is None else samples.native, quick, into)

    def decode(
        self,
        data: bytes,
        returns: npt.NDArray[np.bool_],
        step: int,
        levels: npt.NDArray[np.int32],
        fired: npt.NDArray[np.bool_],
        half: npt.NDArray[np.uint8],
        rotation: npt.NDArray[np.int32],
        expected: npt.NDArray[np.uint16],
        known: int,
        before: npt.NDArray[np.uint16],
    ) -> npt.NDArray[np.uint16]:
        """(64, W) uint16. Raises SectionError or TruncatedError."""
        given = (data, returns.view(np.uint8), step, levels, fired.view(np.uint8), half, rotation, expected)
        return self._coder.decode(*given, known, before)


def encode_azimuth(azimuth: npt.NDArray[np.uint16], fired: npt.NDArray[np.bool_]) -> bytes:
    """Bytes of the rotations of a frame, (2, W) each; see `azimuth_coder`."""
    return _native.encode_azimuth(azimuth, fired.view(np.uint8))


def decode_azimuth(data: bytes, width: int) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.bool_]]:
    """azimuth (2, W) uint16 and fired (2, W) bool. Raises SectionError or TruncatedError."""
    azimuth, fired = _native.decode_azimuth(data, width)
    return azimuth, fired.view(np.bool_)


def columns_in_turn(rotations: npt.NDArray[np.uint16]) -> int:
    """Columns in a full turn at the mean step of (W,) rotations, 0 if they do not turn; see `azimuth_coder`."""
    return _native.columns_in_turn(rotations)


def encode_planes(
    planes: Sequence[npt.NDArray[np.uint32]],
    forms: npt.NDArray[np.uint8],
    shift: npt.NDArray[np.int32],
    step: int,
    *,
    quick: bool,
) -> bytes:
    """Bytes of P planes, (H, W) each; see `plane_coder`. forms: (P, 4) role, bits, of, like; shift: (H,)."""
    return _native.encode_planes(planes, forms, shift, step, quick)


def decode_planes(
    data: bytes, columns: int, forms: npt.NDArray[np.uint8], shift: npt.NDArray[np.int32], step: int
) -> list[npt.NDArray[np.uint32]]:
    """P planes, (H, W) each. Raises SettingsError, SectionError or TruncatedError."""
    return _native.decode_planes(data, columns, forms, shift, step)
