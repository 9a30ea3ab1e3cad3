"""zstd that had too little memory: it says so in the words of damaged data, and that is another thing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import zstandard

_SAYS: Final = "not enough memory"
"""The name that zstd gives ZSTD_error_memory_allocation (zstd, lib/common/error_private.c)."""


@contextmanager
def memory_told() -> Iterator[None]:
    """Within it, zstd's errors for lack of memory are MemoryError. Raises it, and zstandard.ZstdError for all else."""
    try:
        yield
    except zstandard.ZstdError as error:
        if _SAYS in str(error):
            raise MemoryError(str(error)) from None
        raise
