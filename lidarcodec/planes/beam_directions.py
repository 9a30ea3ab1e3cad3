"""Where the beams of a sensor look, as frames that follow each other tell it: `SensorView` in `entropy.plane_coder`."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import CalibrationError
from lidarcodec.frame import Frame
from lidarcodec.frame_images import RANGE, images_of, layout_of
from lidarcodec.sensors.images import Images

Beams = npt.NDArray[np.int32]

STEPS_PER_TURN: Final = 1 << 20
_FAR: Final = 60_000
"""Range steps from one point of a beam to another."""


def beam_directions(frame: Frame) -> Beams | None:
    """(H, 2) as of `SensorView.beams`: means over the columns of a frame.

    Lasers of a column fire one after the other while the head turns, so a beam is aside by its mean. None without
    columns, or where the directions of beams are not known.
    """
    found = layout_of(frame)
    if found is None or not frame.width:
        return None
    family, layout = found
    images = images_of(frame, layout)
    ranges = images.planes[RANGE]
    far = min(_FAR, (1 << layout.planes[0].bits) - 1)
    filled = [Images({**images.planes, RANGE: np.full_like(ranges, steps)}, images.series) for steps in (0, far)]
    try:
        ends = [family.points(frame.sensor, layout, one) for one in filled]
    except CalibrationError:
        return None
    x, y, z = (end - start for start, end in zip(*ends, strict=True))
    up = np.arctan2(z, np.hypot(x, y)).mean(axis=1)
    aside = np.arctan2(-y, x) - np.radians(frame.azimuth[0] * 0.01)
    aside = np.arctan2(np.sin(aside).mean(axis=1), np.cos(aside).mean(axis=1))
    steps = np.rint(np.stack((up, aside), axis=1) * (STEPS_PER_TURN / (2 * np.pi)))
    return np.ascontiguousarray(steps.astype(np.int32))


class BeamBook:
    """The beams of the last sensor: they are the same in all its frames."""

    def __init__(self) -> None:
        self._of: tuple[str, str] | None = None
        self._beams: Beams | None = None

    def of(self, frame: Frame) -> Beams | None:
        """As `beam_directions`, of the first frame with columns of this sensor and this layout."""
        found = layout_of(frame)
        if found is None:
            return None
        known = (frame.sensor.hash, found[1].name)
        if known != self._of and frame.width:
            self._of, self._beams = known, beam_directions(frame)
        return self._beams if known == self._of else None
