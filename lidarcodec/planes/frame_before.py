"""What the planes of a frame of another sensor than an HDL-64E refer to: the frames since the last key message.

`SentBefore` is of an encoder; the decoder is native/src/session. Both forget everything with a message that needs no
other.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy.plane_coder import PlaneMemory, SensorView
from lidarcodec.frame import Frame
from lidarcodec.planes.beam_directions import BeamBook
from lidarcodec.planes.plane_section import Following
from lidarcodec.units import AZIMUTH_TURN

Azimuths = npt.NDArray[np.uint16]
Runs = npt.NDArray[np.uint32]

_BLOCK: Final = 32
"""Columns that are looked up together."""
_LEAST_DRIFT: Final = 0.8
"""Columns by which a block is off before it is looked up anew: each run takes three bytes."""


def runs_between(before: Azimuths, now: Azimuths) -> Runs | None:
    """(N, 2), runs of columns as of `PlaneMemory.encode`, that look in the same directions in the frame before.

    before, now: (V,) and (W,) hundredths of a degree, of the columns of two frames. None if one of them has no
    columns, or most columns look elsewhere.
    """
    if len(before) == 0 or len(now) == 0:
        return None
    old, new = _unwrapped(before), _unwrapped(now)
    turn = float(new[0] - old[0])
    new += (turn + AZIMUTH_TURN / 2) % AZIMUTH_TURN - AZIMUTH_TURN / 2 - turn  # the short way round
    if np.count_nonzero((new >= old[0]) & (new <= old[-1])) * 2 < len(now):
        return None
    off = np.interp(new, old, np.arange(len(old))) - np.arange(len(new))
    starts: list[tuple[int, int]] = []
    drift: int | None = None
    for x in range(0, len(new), _BLOCK):
        here = float(np.median(off[x : x + _BLOCK]))
        if drift is None or abs(here - drift) > _LEAST_DRIFT:
            drift = round(here)
            starts.append((x, (x + drift) % len(old)))
    found = np.array(starts, np.int64)
    counts = np.diff(np.append(found[:, 0], len(new)))
    return np.stack((counts, found[:, 1]), axis=1).astype(np.uint32)


def _unwrapped(azimuth: Azimuths) -> npt.NDArray[np.float64]:
    """(W,) float64 that never fall: directions without the jump at the end of a turn."""
    wide = azimuth.astype(np.int64)
    steps = np.mod(np.diff(wide) + AZIMUTH_TURN // 2, AZIMUTH_TURN) - AZIMUTH_TURN // 2
    return np.maximum.accumulate(np.append(0.0, np.cumsum(steps)) + float(azimuth[0]))


class SentBefore:
    """What an encoder sent since the last message that needs no other."""

    def __init__(self) -> None:
        self._memory: Final = PlaneMemory()
        self._last: int | None = None
        self._azimuth: Azimuths | None = None
        self._beams: Final = BeamBook()

    def begin(self, *, alone: bool) -> int | None:
        """Index of the frame that the next one needs, or None. A frame that is not `taken` later begins from nothing.

        alone: the frame refers to no other
        """
        needs, self._last = (None if alone else self._last), None
        if needs is None:
            self._memory.forget()
            self._azimuth = None
        return needs

    def following(self, frame: Frame, azimuth: Azimuths) -> Following:
        """What the planes of the frame follow. azimuth: (W,) of the columns that are sent."""
        before, self._azimuth = self._azimuth, azimuth.copy()
        beams = self._beams.of(frame)
        view = None if beams is None else SensorView(beams, azimuth, 1 / frame.sensor.range_step_m)
        return Following(self._memory, None if before is None else runs_between(before, azimuth), view)

    def take(self, index: int) -> None:
        """The frame of this index was coded."""
        self._last = index
