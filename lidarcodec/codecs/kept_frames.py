"""KeptFrames: what an encoder remembers after the last few frames, so that the next one may refer to any of them.

A live encoder refers to a frame that its receiver has. Where every message arrives, and offline, that is the frame
before, and nothing else is kept. Decoders keep as much (docs/wire-format.md, "Which frames a message may refer to").

>>> kept = KeptFrames[list[str]](list.copy)
>>> kept.put(0, ["0"])
>>> kept.refer_to({0})
>>> for index in (1, 2, 3):  # what was sent since is not there
...     needs, memory = kept.reference()
...     kept.put(index, [*memory, str(index)])
>>> needs, memory
(0, ['0'])
>>> kept.refer_to({0, 1, 3}); kept.reference()
(3, ['0', '3'])
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Set
from typing import Final, Generic, TypeVar

from lidarcodec.entropy import IntensityMemory
from lidarcodec.frame import WHOLE, Frame

KEPT_FRAMES: Final = 5
"""Number of frames that a message may refer to: those last coded, or referred to, since the last that needs none."""

Memory = TypeVar("Memory")


class KeptFrames(Generic[Memory]):
    """The memory of a stream after each of its last frames. copy: copies a memory"""

    def __init__(self, copy: Callable[[Memory], Memory]) -> None:
        self._copy: Final = copy
        self._kept: OrderedDict[int, Memory] = OrderedDict()
        self._wanted: Set[int] | None = None

    def refer_to(self, indices: Set[int] | None) -> None:
        """Refer to the newest of these frames that is kept, to none without any. None: to the frame before."""
        self._wanted = indices

    def forget(self) -> None:
        """Begin from nothing."""
        self._kept.clear()

    def reference(self) -> tuple[int, Memory] | None:
        """Index of the frame to refer to, and what is remembered after it, for the caller to change; None: begin from
        nothing."""
        wanted = self._wanted
        if wanted is None:
            return self._kept.popitem() if self._kept else None
        found = max((index for index in self._kept if index in wanted), default=None)
        if found is None:
            return None
        self._kept.move_to_end(found)
        return found, self._copy(self._kept[found])

    def go_on(self, index: int) -> Memory | None:
        """What is remembered after this frame, if it is the last, for a part that takes its place; else None."""
        if not self._kept or next(reversed(self._kept)) != index:
            return None
        return self._kept.pop(index)

    def put(self, index: int, memory: Memory) -> None:
        """Keep what is remembered after a frame that was coded."""
        if self._wanted is None:
            self._kept.clear()
        self._kept[index] = memory
        while len(self._kept) > KEPT_FRAMES:
            self._kept.popitem(last=False)


class TurnParts:
    """The parts of the turns that an encoder codes, and what they taught the coder of intensities. A part goes on where
    the one before it was coded; else it begins anew, as a turn does."""

    def __init__(self) -> None:
        self._intensities: Final = IntensityMemory()
        self._open: int | None = None  # index of the part that the next one goes on from

    def goes_on(self, frame: Frame, *, key: bool) -> bool:
        """Whether the frame that is coded now goes on from the part before. Until `coded` no other one does."""
        before, self._open = self._open, None
        return frame.part.goes_on and not key and before == frame.index - 1

    def memory(self, frame: Frame, *, goes_on: bool) -> IntensityMemory | None:
        """What the parts before taught the coder of intensities; None of a whole frame."""
        if not goes_on:
            self._intensities.forget_models()
        return None if frame.part == WHOLE else self._intensities

    def coded(self, frame: Frame) -> None:
        """A frame was coded."""
        self._open = frame.index if frame.part.more else None
