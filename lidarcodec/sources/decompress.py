"""The bytes of a file, decompressed if its content is gzip, xz or zstd. The file's name does not matter.

A cut or damaged file gives every byte before the damage and then ends; `problem` says what is wrong. Memory is bounded
for any file: at most 1 MiB a step from gzip and xz, 32 MiB from zstd, windows up to 128 MiB. Work is bounded too: data
that expands more than a thousandfold ends there, because captures do not. Nothing is written to a disk.

>>> import gzip, tempfile
>>> with tempfile.NamedTemporaryFile() as file:
...     _ = file.write(gzip.compress(b"packets")[:-3])
...     file.flush()
...     stream = ByteStream(Path(file.name))
...     stream.read(), stream.read(), stream.problem
(b'packets', b'', 'the gzip data is cut off')
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO, NamedTuple, Protocol

import zstandard

from lidarcodec.budgets import EXPANDED_BASE, EXPANDED_TIMES, Allowance
from lidarcodec.errors import SourceError
from lidarcodec.files.regular import open_regular

CHUNK = 1 << 20
"""Bytes read from a plain file at once."""
OUT_LIMIT = 1 << 20
ZSTD_STEP = 1 << 10
"""Compressed bytes given to zstd at once. zstd cannot limit its output, and a block of 4 bytes may hold 128 KiB."""
WINDOW_LIMIT = 1 << 27
XZ_MEMORY = 1 << 28


class _Decoder(Protocol):
    """A decompressor of one compressed member."""

    def feed(self, data: bytes) -> bytes:
        """Output that became ready."""

    @property
    def hungry(self) -> bool:
        """Whether it needs more input."""

    @property
    def rest(self) -> bytes | None:
        """Input after the end of the member; None before the end."""


class _Gzip:
    def __init__(self) -> None:
        self._inner = zlib.decompressobj(wbits=31)
        self._full = False  # zlib may hold output back without any input left

    def feed(self, data: bytes) -> bytes:
        out = self._inner.decompress(self._inner.unconsumed_tail + data, OUT_LIMIT)
        self._full = len(out) == OUT_LIMIT
        return out

    @property
    def hungry(self) -> bool:
        return not self._full and not self._inner.unconsumed_tail

    @property
    def rest(self) -> bytes | None:
        return self._inner.unused_data if self._inner.eof else None


class _Xz:
    def __init__(self) -> None:
        self._inner = lzma.LZMADecompressor(memlimit=XZ_MEMORY)

    def feed(self, data: bytes) -> bytes:
        return self._inner.decompress(data, OUT_LIMIT)

    @property
    def hungry(self) -> bool:
        return self._inner.needs_input

    @property
    def rest(self) -> bytes | None:
        # xz pads its streams with zeros to a multiple of four bytes
        return self._inner.unused_data.lstrip(b"\0") if self._inner.eof else None


class _Zstd:
    def __init__(self) -> None:
        self._inner = zstandard.ZstdDecompressor(max_window_size=WINDOW_LIMIT).decompressobj()
        self._waiting = b""

    def feed(self, data: bytes) -> bytes:
        data = self._waiting + data
        self._waiting = data[ZSTD_STEP:]
        return self._inner.decompress(data[:ZSTD_STEP])

    @property
    def hungry(self) -> bool:
        return not self._waiting

    @property
    def rest(self) -> bytes | None:
        return self._inner.unused_data + self._waiting if self._inner.eof else None


class _Member(NamedTuple):
    """A kind of compression. A file may consist of several members of one kind."""

    kind: str
    magic: bytes
    decoder: Callable[[], _Decoder]


_MEMBERS = (
    _Member("gzip", b"\x1f\x8b", _Gzip),
    _Member("xz", b"\xfd7zXZ\0", _Xz),
    _Member("zstd", b"\x28\xb5\x2f\xfd", _Zstd),
)
_ERRORS = (zlib.error, lzma.LZMAError, zstandard.ZstdError, MemoryError)


class ByteStream:
    """The bytes of a file, decompressed. `problem` says why it ended early; None if it did not.

    taken: bytes read from the disk so far

    Raises SourceError if the file cannot be opened or read.
    """

    def __init__(self, path: Path, file: IO[bytes] | None = None) -> None:
        """file: an open one to read instead, unbuffered, such as a pipe; `close` closes it. path: its name then"""
        self.problem: str | None = None
        self.taken = 0
        self._expands = Allowance(EXPANDED_BASE, EXPANDED_TIMES)
        self._path = path
        try:
            self._file: IO[bytes] = open_regular(path, buffering=0) if file is None else file
        except OSError as error:
            raise SourceError(f"cannot open {path}: {error.strerror or error}") from None
        self._head = self._past_empty_frames(self._read_file(6))
        self._member = next((m for m in _MEMBERS if self._head.startswith(m.magic)), None)
        self._decoder: _Decoder | None = self._member.decoder() if self._member else None

    def read(self, at_least: int = 1) -> bytes:
        """The next bytes, at least `at_least`; fewer at the end of the file, then none."""
        data = self._read_some()
        if not data or len(data) >= at_least:
            return data
        parts, size = [data], len(data)
        while size < at_least and (data := self._read_some()):
            parts.append(data)
            size += len(data)
        return b"".join(parts)

    def _read_some(self) -> bytes:
        if self._member is None:
            data, self._head = self._head, b""
            return data or self._read_file(CHUNK)
        while self._decoder is not None and self.problem is None:
            data, self._head = self._head, b""
            if not data and self._decoder.hungry:
                data = self._read_file(CHUNK // 16)
                if not data:
                    self.problem = f"the {self._member.kind} data is cut off"
                    break
            out = self._decompressed(self._member, self._decoder, data)
            if out:
                return out
        return b""

    def _decompressed(self, member: _Member, decoder: _Decoder, data: bytes) -> bytes:
        try:
            out = decoder.feed(data)
        except _ERRORS as error:
            self.problem = f"the {member.kind} data is damaged ({error})"
            return b""
        if not self._expands.spend(len(out), self.taken):
            self.problem = (
                f"the {member.kind} data is damaged (it expands to more than {EXPANDED_TIMES} times its size)"
            )
            return b""
        rest = decoder.rest
        if rest is not None:  # the end of a member; files may be joined from several
            self._head = self._past_empty_frames(rest or self._read_file(CHUNK // 16))
            if not self._head:
                self._decoder = None
            elif self._head.startswith(member.magic):
                self._decoder = member.decoder()
            else:
                self.problem = f"there is other data after the {member.kind} data"
        return out

    def _past_empty_frames(self, data: bytes) -> bytes:
        """The input after skippable frames of zstd (RFC 8878, section 3.1.2), as in pzstd and seekable files."""
        while len(data) >= 4 and data[0] >> 4 == 5 and data[1:4] == b"\x2a\x4d\x18":
            data += self._read_file(8 - len(data)) if len(data) < 8 else b""
            left = 8 + int.from_bytes(data[4:8], "little")
            while left >= len(data):
                left -= len(data)
                data = self._read_file(CHUNK // 16)
                if not data:
                    if left:
                        self.problem = "the zstd data is cut"
                    return b""
            data = data[left:]
            data += self._read_file(6 - len(data)) if len(data) < 6 else b""
        return data

    def _read_file(self, size: int) -> bytes:
        try:
            data = self._file.read(size)
        except OSError as error:
            raise SourceError(f"cannot read {self._path}: {error.strerror or error}") from None
        self.taken += len(data)
        return data

    def close(self) -> None:
        """Close the file."""
        self._file.close()
