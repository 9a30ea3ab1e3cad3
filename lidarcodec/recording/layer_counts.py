"""LayerCounts: how many frames of a recording of two layers were refined.

Live recordings do not say with which settings they were made. One is known to have two layers by its first refinement;
the frames before that are counted then.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from typing import Final

from lidarcodec.layers import RefinedFrame, can_be_base
from lidarcodec.message import Message
from lidarcodec.recording.reader import RecordingReader
from lidarcodec.untrusted.json import read_object

LAYERS: Final = ("whole", "part", "base")
"""How a frame of two layers can be refined."""


class LayerCounts:
    """Counts frames while a recording is read.

    counts: frames refined `whole`, in `part` or not at all (`base`); empty for a recording of one layer
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._before: Counter[str] = Counter()

    @property
    def unrefined(self) -> int:
        """Frames that are not refined whole."""
        return self.counts["part"] + self.counts["base"]

    def add(self, reader: RecordingReader, message: Message, refined: RefinedFrame | None) -> None:
        """Count the frame of a message. refined: its refinements, None if it has none"""
        if refined is None and not can_be_base(message):
            return
        self._before[_layers(refined)] += 1
        if refined is not None or reader.refinements.came or _said(reader):
            self.counts += self._before
            self._before.clear()


def _layers(refined: RefinedFrame | None) -> str:
    if refined is None or not refined.taken:
        return "base"
    return "whole" if refined.whole else "part"


def _said(reader: RecordingReader) -> bool:
    """Whether the settings in the metadata have two layers."""
    with suppress(ValueError):
        return read_object(reader.metadata.get("settings", "{}")).get("base_error_m") is not None
    return False
