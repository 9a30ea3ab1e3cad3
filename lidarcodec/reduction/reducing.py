"""Reducing: the reducer of a stream. Its settings may change between two frames."""

from __future__ import annotations

from typing import Any

from lidarcodec.codecs.table import codec
from lidarcodec.frame import Frame
from lidarcodec.reduction.base import Reducer
from lidarcodec.reduction.lattice import LatticeReducer
from lidarcodec.reduction.table import budget_of, make_reducer, note_of
from lidarcodec.settings import AUTO, StreamSettings


class Reducing:
    """Has the reducer of the settings.

    Raises SettingsError if there is no such reducer.
    """

    def __init__(self, settings: StreamSettings, before: Reducing | None = None) -> None:
        """before: the object for the previous settings; if only the budget changes, the reducer keeps its state"""
        self._name, self._budget = settings.reduction, budget_of(settings)
        goes_on = before is not None and before._name == self._name
        self._reducer: Reducer = before._reducer if before is not None and goes_on else make_reducer(settings)
        if isinstance(self._reducer, LatticeReducer):
            self._reducer.rolling = codec(settings.codec).rolling
        self._last: dict[str, Any] = before._last if before is not None and goes_on else {}

    def reduce(self, frame: Frame) -> Frame:
        """The frame with `keep` set; the frame itself if all of it is kept."""
        if self._name in (AUTO, "all"):
            return frame
        self._reducer.budget = self._budget
        reduced = self._reducer.reduce(frame)
        self._last = {"returns": int(frame.valid.sum()), "kept": int(reduced.valid.sum()), **self._reducer.report()}
        return reduced

    def report(self) -> dict[str, Any] | None:
        """For the status: the name, `returns` of the last frame and `kept` of them (null before the first frame),
        further fields of the reducer, and its `note` if it has one; None if all returns are sent."""
        if self._name in (AUTO, "all"):
            return None
        note = note_of(self._name)
        about = {"name": self._name, "returns": None, "kept": None, **self._last}
        return about if note is None else {**about, "note": note}
