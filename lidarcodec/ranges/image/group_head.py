"""The head of a message with several frames: index, stamp, width, packets and first column (layers.py) of each frame.

The header of the message has the index and stamp of the first frame, and the largest width and number of packets.

turn u16, then for each frame: index minus the header's u32, stamp minus the header's i64, width u16, packets u16,
start u32.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from lidarcodec.errors import LidarCodecError, SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.ranges.image.layers import Layers

TURN: Final = struct.Struct("<H")
MEMBER: Final = struct.Struct("<IqHHI")


def packets_in(frame: Frame) -> int:
    """Number of packets of a frame, 0 if it never was packets."""
    return 0 if frame.side is None else frame.side.packets


def pack_group(frames: Sequence[Frame], layers: Layers) -> bytes:
    """The head.

    Raises LidarCodecError if a stamp or index is too far from the first one's.
    """
    parts = [TURN.pack(layers.turn)]
    try:
        for frame, start in zip(frames, layers.starts, strict=True):
            index, stamp_ns = frame.index - frames[0].index, frame.stamp_ns - frames[0].stamp_ns
            parts.append(MEMBER.pack(index, stamp_ns, frame.width, packets_in(frame), start))
    except struct.error:
        raise LidarCodecError("frames too far from one another to be one group") from None
    return b"".join(parts)


class Group(NamedTuple):
    """alone: for each frame of a message one as if it were alone; turn and starts: as of `Layers`

    rest: what follows the head
    """

    alone: list[Message]
    turn: int
    starts: tuple[int, ...]
    rest: bytes

    def layers(self, widths: Sequence[int], lasers: int) -> Layers:
        """The layout. widths: columns of each frame that are sent; lasers: rows of a frame. Raises SectionError."""
        return Layers(self.turn, self.starts, tuple(widths), lasers)


def split_group(data: bytes, message: Message) -> Group:
    """The frames of a message, and where they lie. data: the section from the head on

    Raises SectionError.
    """
    size = TURN.size + message.frame_count * MEMBER.size
    if len(data) < size:
        raise SectionError(f"a range section of {len(data)} bytes for {message.frame_count} frames")
    members = list(MEMBER.iter_unpack(data[TURN.size : size]))
    alone, last = [], -1
    for ordinal, (index, later_ns, width, packets, _) in enumerate(members):
        stamp_ns = message.stamp_ns + later_ns
        if index <= last or (not ordinal and (index or later_ns)):
            raise SectionError(f"frame {index} of a group after frame {last}")
        if not -(2**63) <= stamp_ns < 2**63 or message.frame_index + index >= 2**63:
            raise SectionError("a frame of a group beyond the end of time")
        if width > message.width or packets > message.packets:
            raise SectionError(f"a frame of {width} columns and {packets} packets in a message of narrower ones")
        last = index
        sections = tuple(one._replace(ordinal=0) for one in message.sections if one.ordinal == ordinal)
        alone.append(
            replace(
                message,
                frame_index=message.frame_index + index,
                stamp_ns=stamp_ns,
                width=width,
                packets=packets,
                sections=sections,
                frame_count=1,
            )
        )
    return Group(alone, TURN.unpack_from(data)[0], tuple(one[4] for one in members), data[size:])
