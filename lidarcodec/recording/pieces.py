"""Pieces of recordings: a key message and the messages that follow it, up to the next one. Each is decoded alone.

A piece is known by the SHA-256 of its messages, one after the other, so both ends of a transfer name it alike, whatever
happened in between. Nothing is stored beside the recordings: pieces are found by reading them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from lidarcodec import wire
from lidarcodec.errors import DecodeError, SectionError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.recording.layout import MESSAGE_ENCODING
from lidarcodec.recording.reader import RecordingReader

MAX_PIECE: Final = 64 * 2**20
"""Largest piece in bytes; a longer one is cut at messages, and then only its first part is decoded alone."""


class Piece(NamedTuple):
    """A piece: its name, times in ns since the Unix epoch, bytes and frames, and where its messages are in the file.

    begin_ns: stamp of the first message;  end_ns: when the frame after the last one is expected
    places: (offset, length) of each message
    """

    name: str
    begin_ns: int
    end_ns: int
    size: int
    frames: int
    places: tuple[tuple[int, int], ...] = ()

    def about(self) -> dict[str, int | str]:
        """The fields that are sent to receivers."""
        told = ("name", "begin_ns", "end_ns", "size", "frames")
        return {field: getattr(self, field) for field in told}

    def overlaps(self, from_ns: int, to_ns: int) -> bool:
        """Whether a part of it lies in a span of time. `to_ns` is outside."""
        return self.begin_ns < to_ns and (self.end_ns > from_ns or self.begin_ns >= from_ns)


def pieces_in(path: Path, *, growing: bool = False) -> list[Piece]:
    """The pieces of a recording, in the order of the file. Damaged messages are left out.

    growing: whether the file is still written; its last piece is left out then, because it may grow
    Cost: reading the file. Raises OSError, SourceError if it is no recording.
    """
    found: list[Piece] = []
    with open_regular(path) as file:
        group = _Group()
        for channel, stored in RecordingReader(file, warn=False).everything():
            if channel.encoding != MESSAGE_ENCODING:
                continue
            data = stored.data()
            try:
                header = wire.peek(data)
            except DecodeError:
                continue
            if (header.key or group.size + len(data) > MAX_PIECE) and group.places:
                found.append(group.piece())
                group = _Group()
            if header.key or group.places:
                group.add(header, data, stored.start)
        if group.places and not growing:
            found.append(group.piece())
    return found


def read_piece(path: Path, piece: Piece) -> bytes:
    """The messages of a piece, one after the other.

    Raises OSError, and SourceError if the file does not hold them any more.
    """
    with open_regular(path) as file:
        parts = []
        for offset, length in piece.places:
            file.seek(offset)
            parts.append(file.read(length))
    data = b"".join(parts)
    if hashlib.sha256(data).hexdigest() != piece.name:
        raise SourceError(f"{path.name} has changed: a piece of it does not match its checksum")
    return data


def messages_in(data: bytes) -> Iterator[bytes]:
    """The messages of a piece.

    Raises DecodeError if the bytes are not whole messages.
    """
    at = 0
    while at < len(data):
        size = wire.peek(data[at : at + wire.HEADER_BYTES]).total_bytes
        if at + size > len(data):
            raise SectionError("a piece ends within a message", at)
        yield data[at : at + size]
        at += size


class _Group:
    """Messages of a piece while they are read."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._first_ns = self._last_ns = 0
        self._frames = self.size = 0
        self.places: list[tuple[int, int]] = []

    def add(self, header: wire.Header, data: bytes, offset: int) -> None:
        """Add the next message."""
        if not self.places:
            self._first_ns = header.stamp_ns
        self._last_ns = header.stamp_ns
        self._hash.update(data)
        self.size += len(data)
        self._frames += header.frame_count
        self.places.append((offset, len(data)))

    def piece(self) -> Piece:
        """What was added."""
        step_ns = (self._last_ns - self._first_ns) // max(len(self.places) - 1, 1)
        end_ns = self._last_ns + max(step_ns, 0)
        return Piece(self._hash.hexdigest(), self._first_ns, end_ns, self.size, self._frames, tuple(self.places))
