"""zstd with the size known beforehand: a frame is opened only if it says the size that is expected."""

from __future__ import annotations

from typing import Final

import zstandard

from lidarcodec.entropy.zstd_memory import memory_told
from lidarcodec.errors import SectionError

_HEAD_BYTES: Final = 18
"""The longest zstd frame header."""


def compress(data: bytes, level: int) -> bytes:
    """One zstd frame that states its size."""
    with memory_told():
        return zstandard.ZstdCompressor(level=level).compress(data)


def decompress(data: bytes, size: int) -> bytes:
    """The `size` bytes of one zstd frame.

    Raises SectionError if the frame is damaged, holds or announces another size, or is followed by further bytes.
    """
    try:
        announced = zstandard.get_frame_parameters(data[:_HEAD_BYTES]).content_size
        if announced != size:
            raise SectionError(f"a zstd frame of {announced} bytes where {size} are expected")
        with memory_told():
            plain = zstandard.ZstdDecompressor().decompress(data, max_output_size=size, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise SectionError(f"damaged zstd frame: {error}") from None
    if len(plain) != size:
        raise SectionError(f"a zstd frame that holds {len(plain)} bytes where {size} are expected")
    return plain
