"""MOUNT sections: added to key messages by the encoder, remembered by the decoder until the next key message.

Codecs know nothing of mountings: a mounting belongs to the sensor, and only its stream says it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from lidarcodec.message import Message, Section, SectionType
from lidarcodec.mounting import Matrix, decode_mount, encode_mount, is_same

if TYPE_CHECKING:
    from lidarcodec.frame import Frame


class MountNotes:
    """The mounting of the frames that an encoder codes now."""

    def __init__(self) -> None:
        self._mount: Matrix | None = None
        self._section: tuple[Section, ...] = ()

    def differs(self, frame: Frame) -> bool:
        """Whether the frame has another mounting than those before."""
        return not is_same(self._mount, frame.mount)

    def take(self, frame: Frame) -> None:
        """Use the mounting of this frame. Raises SectionError for one that no reader takes."""
        if frame.mount is self._mount:
            return
        section = () if frame.mount is None else (Section(SectionType.MOUNT, encode_mount(frame.mount)),)
        self._mount, self._section = frame.mount, section

    def noted(self, message: Message) -> Message:
        """The message, with a MOUNT section if it is a key message and the mounting is known."""
        if not message.key or not self._section:
            return message
        return replace(message, sections=message.sections + self._section)


class MountMemory:
    """The mounting that the last key message of a stream said."""

    def __init__(self) -> None:
        self._mount: Matrix | None = None
        self._data: bytes | None = None
        self._stream: int | None = None

    def read(self, message: Message) -> Matrix | None:
        """(4, 4) of this message's frames; None if it is not known. Raises SectionError."""
        has = message.has(SectionType.MOUNT)
        if message.stream_id != self._stream or (message.key and not has):
            self._mount = self._data = None
            self._stream = message.stream_id
        if has and (data := message.section(SectionType.MOUNT)) != self._data:
            self._mount, self._data = decode_mount(data), data
        return self._mount


def mounted(frames: list[Frame], mount: Matrix | None) -> list[Frame]:
    """The frames with this mounting."""
    return frames if mount is None else [frame.with_(mount=mount) for frame in frames]
