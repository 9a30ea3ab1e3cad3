"""A stream that cannot be sought, such as a pipe, for writers that ask where they are."""

from __future__ import annotations

import contextlib
from typing import IO


class Counting:
    """A pipe as writers of files want it: it knows where it is. bytes: written so far"""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self.bytes = stream, 0

    def write(self, data: bytes) -> int:
        self._stream.write(data)
        self.bytes += len(data)
        return len(data)

    def tell(self) -> int:
        """Bytes so far."""
        return self.bytes

    def flush(self) -> None:
        self._stream.flush()

    def close(self) -> None:
        """Close it; what was not flushed may be lost."""
        with contextlib.suppress(OSError):
            self._stream.close()
