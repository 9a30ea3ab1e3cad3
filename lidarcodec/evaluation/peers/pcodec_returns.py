"""`peer:pcodec`: the quantised returns, row by row, with plain pcodec, and their mask with zstd.

pcodec uses differences of consecutive values at its highest level. Our own codec `pcodec` also sorts these differences
by local activity.
"""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt
import zstandard
from pcodec import ChunkConfig, DeltaSpec, standalone

from lidarcodec.evaluation.peers.base import BOUNDS_M, Coder, Peer, Ranges, from_levels, to_levels

_HEAD = struct.Struct("<HHI")
_AS_DIFFERENCES = ChunkConfig(12, delta_spec=DeltaSpec.try_consecutive(1))


def compress_returns(ranges: Ranges, max_error_m: float) -> bytes:
    """Compress only the returns of (64, W) uint16 ranges, 0 = no return."""
    levels = to_levels(ranges, max_error_m)
    return bytes(standalone.simple_compress(levels[levels > 0], _AS_DIFFERENCES))


def decompress_returns(data: bytes, valid: npt.NDArray[np.bool_], max_error_m: float) -> Ranges:
    """(64, W) uint16 ranges from the bytes of `compress_returns`; valid: where there are returns."""
    levels = np.zeros(valid.shape, np.uint16)
    if valid.any():  # for no values the library returns None
        levels[valid] = standalone.simple_decompress(data)
    return from_levels(levels, max_error_m)


def _make(max_error_m: float) -> Coder:
    def encode(ranges: Ranges) -> bytes:
        mask = zstandard.ZstdCompressor(level=9).compress(np.packbits(ranges > 0).tobytes())
        return _HEAD.pack(*ranges.shape, len(mask)) + mask + compress_returns(ranges, max_error_m)

    def decode(data: bytes) -> Ranges:
        rows, width, size = _HEAD.unpack_from(data)
        bits = np.frombuffer(zstandard.decompress(data[_HEAD.size : _HEAD.size + size]), np.uint8)
        valid = np.unpackbits(bits, count=rows * width).reshape(rows, width).astype(bool)
        return decompress_returns(data[_HEAD.size + size :], valid, max_error_m)

    return Coder(encode, decode)


PEER = Peer("ranges", "max_error_m", BOUNDS_M, ("pcodec", "zstandard"), _make)
