"""An MCAP file while it is written: the base of both writers."""

from __future__ import annotations

from typing import IO, Self, cast

from mcap.writer import CompressionType, Writer

import lidarcodec
from lidarcodec.entropy.zstd_memory import memory_told
from lidarcodec.files.counting import Counting


class McapFile:
    """Writes messages to an open binary file, which the caller closes."""

    def __init__(self, stream: IO[bytes], chunk_bytes: int, *, compressed: bool, profile: str = "") -> None:
        """chunk_bytes: size from which a chunk is closed."""
        self._stream, self._finished = stream, False
        try:
            stream.tell()
        except OSError:  # a pipe
            stream = cast(IO[bytes], Counting(stream))
        compression = CompressionType.ZSTD if compressed else CompressionType.NONE
        self._mcap = Writer(stream, chunk_size=chunk_bytes, compression=compression)
        self._mcap.start(profile=profile, library=f"lidarcodec {lidarcodec.__version__}")

    def close(self) -> None:
        """Write index and footer. A second call does nothing. The file itself stays open."""
        if not self._finished:
            self._finished = True
            with memory_told():
                self._mcap.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _add_message(self, channel: int, stamp_ns: int, data: bytes, sequence: int) -> None:
        """Add a message of a registered channel. MCAP has no times before 1970: earlier ones become 0."""
        at = max(0, stamp_ns)
        with memory_told():
            self._mcap.add_message(channel, at, data, at, sequence & 0xFFFFFFFF)
