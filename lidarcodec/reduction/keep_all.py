"""`all`: every return is sent."""

from __future__ import annotations

from lidarcodec.frame import Frame
from lidarcodec.reduction.base import Reducer, Reduction


class KeepAll(Reducer):
    """Leaves frames as they are."""

    def reduce(self, frame: Frame) -> Frame:
        """The frame itself."""
        return frame


REDUCTION = Reduction(KeepAll, budgeted=False)
