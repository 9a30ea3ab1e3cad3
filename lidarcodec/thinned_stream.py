"""LATTICE sections: added to messages of thinned frames by the encoder, read by the decoder.

Codecs see narrow frames without side information, and know nothing of lattices. The section holds the list of columns
and the side information of the full frame, so that its packets can be rebuilt (planes/lattice_section.py).
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from lidarcodec.frame import Frame
from lidarcodec.lattice import Lattice, expanded
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.planes.lattice_section import lattice_bytes, read_lattice


class LatticeNotes:
    """Remembers the lattices of frames inside an encoder until their messages come out."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, bytes | None]] = deque()

    def goes_in(self, frame: Frame) -> None:
        """Remember the lattice of a frame, in its full width, that is encoded next."""
        section = None
        if frame.lattice is not None:
            section = lattice_bytes(Lattice(frame.width, frame.lattice, frame.blocks))
        self._waiting.append((frame.index, section))

    def noted(self, message: Message) -> Message:
        """The message with the LATTICE sections of its frames."""
        while self._waiting and self._waiting[0][0] < message.frame_index:
            self._waiting.popleft()  # no message came: its encoder failed
        found = [self._waiting.popleft()[1] for _ in range(min(message.frame_count, len(self._waiting)))]
        sections = tuple(
            Section(SectionType.LATTICE, section, ordinal)
            for ordinal, section in enumerate(found)
            if section is not None
        )
        return replace(message, sections=message.sections + sections) if sections else message


def in_own_columns(frames: list[Frame], message: Message) -> list[Frame]:
    """The decoded frames of a message, with thinned ones expanded to their full width.

    Raises SectionError or TruncatedError for a damaged LATTICE section.
    """
    return [
        expanded(frame, read_lattice(message.section(SectionType.LATTICE, ordinal)))
        if message.has(SectionType.LATTICE, ordinal)
        else frame
        for ordinal, frame in enumerate(frames)
    ]
