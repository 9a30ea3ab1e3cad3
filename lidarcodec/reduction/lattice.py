"""`lattice:n`: every n-th column is sent, with another first column in each frame. The receiver interpolates.

It is for viewers: the same bits show more than with `columns:n`, because the sent columns are coded as a narrow frame.
"""

from __future__ import annotations

from lidarcodec.frame import Frame
from lidarcodec.lattice import MAX_STEP, on_lattice
from lidarcodec.reduction.base import Reducer, Reduction, every_nth

step_of = every_nth("lattice:n sends every n-th column", MAX_STEP)


class LatticeReducer(Reducer):
    """Keeps the columns of a lattice.

    rolling: whether each frame begins at another column; not for codecs that refer to the previous image
    """

    rolling = True

    def reduce(self, frame: Frame) -> Frame:
        """The frame with all returns of the kept columns."""
        return on_lattice(frame, step_of(self.argument or ""), rolling=self.rolling)


REDUCTION = Reduction(LatticeReducer, argument=step_of, example="4", budgeted=False)
