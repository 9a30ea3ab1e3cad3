"""`peer:xz-rows`: differences to the left neighbour of the quantised range image, low bytes first, with xz -9.

It shows how well a general-purpose compressor works with a suitable data layout.
"""

from __future__ import annotations

import lzma
import struct

import numpy as np

from lidarcodec.evaluation.peers.base import Coder, Peer, Ranges, from_levels, to_levels

_SHAPE = struct.Struct("<HI")


def _make(max_error_m: float) -> Coder:
    def encode(ranges: Ranges) -> bytes:
        levels = to_levels(ranges, max_error_m)
        delta = np.diff(levels, axis=1, prepend=np.uint16(0)).view(np.int16)
        folded = ((delta << 1) ^ (delta >> 15)).astype("<u2")
        planes = folded.view(np.uint8).reshape(-1, 2).T.tobytes()
        return _SHAPE.pack(*levels.shape) + lzma.compress(planes, format=lzma.FORMAT_ALONE, preset=9)

    def decode(data: bytes) -> Ranges:
        rows, width = _SHAPE.unpack_from(data)
        planes = np.frombuffer(lzma.decompress(data[_SHAPE.size :]), np.uint8).reshape(2, -1)
        folded = np.ascontiguousarray(planes.T).view("<u2").reshape(rows, width)
        delta = (folded >> 1) ^ (0 - (folded & 1)).astype(np.uint16)
        return from_levels(np.cumsum(delta, axis=1, dtype=np.uint16), max_error_m)

    return Coder(encode, decode)


PEER = Peer("ranges", "max_error_m", (0.0, 0.01, 0.05, 0.2), (), _make)
