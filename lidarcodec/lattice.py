"""A frame thinned to some of its columns: it is coded as a narrower frame, and the receiver restores the full width.

To a codec a thinned frame is a narrow frame, so bits for mask and azimuths shrink with the columns. A LATTICE section
of the message lists the columns (planes/lattice_section.py). The first and the last column are always sent, so that all
columns between can be filled in (filling.py).

>>> columns_of(width=12, step=4, phase=2).tolist()
[0, 2, 6, 10, 11]
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.side import Role, SideInfo
from lidarcodec.units import AZIMUTH_TURN, LASERS

MAX_STEP: Final = 64
_PHASES: Final = 8
"""Largest number of frames after which the phases repeat."""

Columns = npt.NDArray[np.uint16]


class Lattice(NamedTuple):
    """width and side: of the full frame; columns: (K,) uint16, columns that are sent, ascending."""

    width: int
    columns: Columns
    side: SideInfo | None = None


def columns_of(width: int, step: int, phase: int = 0) -> Columns:
    """(K,) uint16, every `step`-th column from `phase` on, with the first and the last one."""
    if not width:
        return np.empty(0, np.uint16)
    chosen = np.zeros(width, np.bool_)
    chosen[phase::step] = True
    chosen[[0, -1]] = True
    return np.flatnonzero(chosen).astype(np.uint16)


def phase_of(index: int, step: int) -> int:
    """First column of frame `index`, 0 to step - 1. Bit-reversed order spreads the phases of following frames evenly:
    a thin object that stands still is seen within a few frames."""
    count = min(step, _PHASES)
    bits = max(count - 1, 1).bit_length()
    order = sorted(range(count), key=lambda place: int(f"{place:0{bits}b}"[::-1], 2))
    return order[index % count] * step // count


def lattice_of(frame: Frame, step: int, *, rolling: bool = True) -> Columns:
    """(K,) uint16, the columns of a frame that are sent when every `step`-th is.

    rolling: whether the first column changes from frame to frame
    A sensor may fire upper and lower halves in different columns (HDL-64E S3). Then every `step`-th column that fired
    the upper half is sent, and every `step`-th that fired the lower half.
    """
    phase = phase_of(frame.index, step) if rolling else 0
    if frame.fired.all():
        return columns_of(frame.width, step, phase)
    halves = [np.flatnonzero(fired) for fired in frame.fired]
    return np.unique(np.concatenate([fired[columns_of(len(fired), step, phase)] for fired in halves])).astype(np.uint16)


def on_lattice(frame: Frame, step: int, *, rolling: bool = True) -> Frame:
    """The frame with only the returns of the columns of `lattice_of` kept; unchanged for a step of 1."""
    if step == 1 or not frame.width:
        return frame
    columns = lattice_of(frame, step, rolling=rolling)
    keep = np.zeros(frame.range.shape, np.bool_)
    keep[:, columns] = frame.valid[:, columns]
    return frame.with_(keep=keep, lattice=columns)


def thinned(frame: Frame) -> Frame:
    """The narrow frame of the columns in `frame.lattice`, as codecs code it; without side information."""
    if frame.lattice is None:
        return frame
    columns = frame.lattice
    keep = None if frame.keep is None else frame.keep[:, columns]
    valid = frame.valid[:, columns]
    if keep is not None and np.array_equal(valid, frame.range[:, columns] > 0):
        keep = None  # every return in these columns is kept
    return frame.with_(
        range=frame.range[:, columns],
        intensity=np.where(valid, frame.intensity[:, columns], np.uint8(0)),
        azimuth=frame.azimuth[:, columns],
        fired=frame.fired[:, columns],
        side=None,
        keep=keep,
        lattice=None,
    )


def expanded(frame: Frame, lattice: Lattice) -> Frame:
    """The inverse of `thinned`: the frame in its full width. Columns that were not sent have no returns.

    Their azimuths are interpolated. In a frame without side information, columns that were not sent did not fire.
    Raises SectionError if the lattice is not that of the frame.
    """
    width, columns, side = lattice
    if len(columns) != frame.width:
        raise SectionError(f"a lattice of {len(columns)} columns for a frame of {frame.width}")
    ranges = np.zeros((LASERS, width), np.uint16)
    intensity = np.zeros((LASERS, width), np.uint8)
    fired = np.zeros((2, width), np.bool_) if side is None else fired_halves(side)
    ranges[:, columns], intensity[:, columns], fired[:, columns] = frame.range, frame.intensity, frame.fired
    azimuth = _azimuths(frame.azimuth, columns, width)
    return frame.with_(
        range=ranges, intensity=intensity, azimuth=azimuth, fired=fired, lattice=columns, side=side, keep=None
    )


def fired_halves(side: SideInfo) -> npt.NDArray[np.bool_]:
    """(2, W) bool, which half of each column the packets held."""
    of_layout = []
    for roles in side.layouts:
        columns: list[list[bool]] = []
        for role in roles:
            if role in (Role.UPPER_OPENS, Role.LOWER_OPENS):
                columns.append([role == Role.UPPER_OPENS, role == Role.LOWER_OPENS])
            elif role in (Role.UPPER_JOINS, Role.LOWER_JOINS) and columns:
                columns[-1][int(role == Role.LOWER_JOINS)] = True
        of_layout.append(np.array(columns, np.bool_).reshape(-1, 2))
    rows = np.concatenate([of_layout[number] for number in side.layout]) if len(side.layout) else np.empty((0, 2), bool)
    return np.ascontiguousarray(rows.T)


def _azimuths(azimuth: npt.NDArray[np.uint16], columns: Columns, width: int) -> npt.NDArray[np.uint16]:
    """(2, width) uint16, azimuths of all columns, interpolated linearly between known ones along the shorter arc.

    In whole numbers, so that every decoder gives the same; rounded to the nearest, halves to even.
    """
    known, places = azimuth.astype(np.int64), columns.astype(np.int64)
    ways = np.diff(known, axis=1, append=known[:, -1:])
    ways = (ways + AZIMUTH_TURN // 2) % AZIMUTH_TURN - AZIMUTH_TURN // 2
    gaps = np.diff(places, append=width)
    before = np.maximum(np.searchsorted(places, np.arange(width), side="right") - 1, 0)
    gone = np.maximum(np.arange(width) - places[before], 0)
    whole, rest = np.divmod(2 * ways[:, before] * gone + gaps[before], 2 * gaps[before])
    wide = known[:, before] + whole
    wide -= (rest == 0) & (wide % 2 == 1)
    turned: npt.NDArray[np.uint16] = np.mod(wide, AZIMUTH_TURN).astype(np.uint16)
    return turned
