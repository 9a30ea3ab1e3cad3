"""Thinning: what of a frame a target bitrate has bits for, by the purpose of its stream.

`localise` sends the returns that a localiser needs, as the reducer `voxel-seen`; all others columns of a lattice.
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
"""Purposes that have a reducer of their own."""


class Thinning:
    """Thins the frames of one stream, in order; not where a reduction is set.

    before: that of this stream under other settings; what it knows goes on where the reducer stays
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
        """The frame of which about one return in `step` is kept.

        The same frame again, at another step, stays as it was the first time where a reducer remembers what it saw.
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
        """As of `Reducing`; None where columns of a lattice are sent."""
        if self._name is None or not self._last:
            return None
        about = {"name": self._name, **self._last}
        note = note_of(self._name)
        return about if note is None else {**about, "note": note}
