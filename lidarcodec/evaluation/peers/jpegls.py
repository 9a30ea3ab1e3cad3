"""`peer:jpegls`: the quantised range image, including its holes, with JPEG-LS (CharLS)."""

from __future__ import annotations

import imagecodecs
import numpy as np

from lidarcodec.evaluation.peers.base import BOUNDS_M, Coder, Peer, Ranges, from_levels, to_levels


def _make(max_error_m: float) -> Coder:
    def encode(ranges: Ranges) -> bytes:
        room = 4 * ranges.nbytes + 4096  # noise can become larger
        return bytes(imagecodecs.jpegls_encode(to_levels(ranges, max_error_m), out=room))

    def decode(data: bytes) -> Ranges:
        return from_levels(np.asarray(imagecodecs.jpegls_decode(data), np.uint16), max_error_m)

    return Coder(encode, decode)


PEER = Peer("ranges", "max_error_m", BOUNDS_M, ("imagecodecs",), _make)
