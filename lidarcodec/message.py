"""Message: a coded frame, or group of frames, as header fields and typed sections; `wire` converts it to bytes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from lidarcodec.errors import SectionError


class SectionType(IntEnum):
    """What a section holds; readers skip types that they do not know."""

    RANGE = 1
    MASK = 2
    INTENSITY = 3
    AZIMUTH = 4
    SIDE = 5
    CALIBRATION = 6
    KEEP = 7
    MOTION = 8
    WEIGHTS = 9
    POSE = 10
    FILLER = 11
    LATTICE = 12
    POSITION = 13
    PLANES = 14
    REST = 15
    CLOUD = 16
    MOUNT = 17


class Section(NamedTuple):
    """A typed part of a message; `ordinal` is the place of its frame in the group, 0 in a message of one frame."""

    type: int
    data: bytes
    ordinal: int = 0


@dataclass(frozen=True)
class Message:
    """One message.

    codec: number of the codec in the table; stream_id: 64 random bits, new at each start of a publisher
    frame_index: of the first frame, frame_count: frames in this message; stamp_ns: host time of the first packet
    key: whether it decodes without any earlier message; needs: index of the frame it refers to, or None
    width: columns of the (widest) frame; packets: packets in it
    planes: whether the frame is of another sensor than an HDL-64E, in PLANES and REST sections
    goes_on: whether the frame is a part of a turn that goes on from the part before, which it needs
    more: whether the frame is a part of a turn of which another part follows
    """

    codec: int
    stream_id: int
    frame_index: int
    stamp_ns: int
    key: bool
    width: int
    packets: int
    sections: tuple[Section, ...]
    frame_count: int = 1
    needs: int | None = None
    planes: bool = False
    goes_on: bool = False
    more: bool = False

    def section(self, kind: SectionType, ordinal: int = 0) -> bytes:
        """Bytes of one section.

        Raises SectionError if the message has none of that type, or two.
        """
        found = [s.data for s in self.sections if s.type == kind and s.ordinal == ordinal]
        if len(found) != 1:
            raise SectionError(f"a message must hold one {kind.name.lower()} section, this one holds {len(found)}")
        return found[0]

    def has(self, kind: SectionType, ordinal: int = 0) -> bool:
        """Whether the message holds a section of that type."""
        return any(s.type == kind and s.ordinal == ordinal for s in self.sections)
