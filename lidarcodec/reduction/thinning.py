"""Thinning: chooses the part of a frame that fits a target bitrate, by the purpose of the stream.

With purpose `localise` the reducer `voxel-seen` chooses the returns. With all others columns of a lattice are sent.
"""

from __future__ import annotations

from typing import Any, Final

from lidarcodec.codecs.table import codec
from lidarcodec.frame import Frame
from lidarcodec.lattice import on_lattice
from lidarcodec.reduction.base import DEFAULT_SEED, Budget, Reducer
from lidarcodec.reduction.table import note_of, reduction
from lidarcodec.settings import AUTO, Purpose, StreamSettings

REDUCERS: Final[dict[Purpose, str]] = {"localise": "voxel-seen"}
"""Purposes with a special reducer."""


class Thinning:
    """Thins the frames of one stream, in order. It does nothing if the settings have a reduction.

    before: the object for the previous settings; its state is kept if the reducer stays
    """

    def __init__(self, settings: StreamSettings, before: Thinning | None = None) -> None:
        self._settings = settings
        self._name = REDUCERS.get(settings.purpose) if settings.reduction == AUTO else None
        self._reducer: Reducer | None = None
        self._last: dict[str, Any] = {}
        self._thinned: tuple[Frame, Frame] | None = None
        if before is not None and before._name == self._name:
            self._reducer, self._last = before._reducer, before._last
        elif self._name is not None:
            self._reducer = reduction(self._name).make(Budget(), None, DEFAULT_SEED)

    def thin(self, frame: Frame, step: int) -> Frame:
        """The frame with about one return in `step` kept.

        If the same frame comes again with another step, a reducer with state does not count it as a new frame.
        """
        if self._reducer is None:
            return on_lattice(frame, step, rolling=codec(self._settings.codec).rolling)
        if self._thinned is None or self._thinned[0] is not frame:
            self._reducer.budget = Budget(fraction=1.0 / step)
            self._thinned = frame, self._reducer.reduce(frame)
        thin = self._thinned[1]
        self._last = {"returns": int(frame.valid.sum()), "kept": int(thin.valid.sum()), **self._reducer.report()}
        return thin

    def report(self) -> dict[str, Any] | None:
        """As `Reducing.report`; None if columns of a lattice are sent."""
        if self._name is None or not self._last:
            return None
        about = {"name": self._name, **self._last}
        note = note_of(self._name)
        return about if note is None else {**about, "note": note}
