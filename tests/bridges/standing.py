"""A car that stands: the same turn over and over, from one place, stamped with the time of now."""

from __future__ import annotations

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from tests.apps.streams import Loop
from tests.packets import sensor

POSE = np.array([[0.0, -1.0, 0.0, 3.5], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 0.25], [0.0, 0.0, 0.0, 1.0]])


class Standing:
    """Poses of a car that stands."""

    def at(self, stamp_ns: int) -> np.ndarray:
        return POSE


def turn() -> Frame:
    """The frame that such a car sends, but for its times."""
    (frame,) = frames_of(Loop(1).packets(), sensor())
    return frame
