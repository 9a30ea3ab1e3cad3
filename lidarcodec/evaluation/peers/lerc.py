"""`peer:lerc`: the quantised range image with Esri's LERC, and its output with zstd."""

from __future__ import annotations

import imagecodecs
import numpy as np

from lidarcodec.evaluation.peers.base import BOUNDS_M, Coder, Peer, Ranges, from_levels, to_levels


def _make(max_error_m: float) -> Coder:
    def encode(ranges: Ranges) -> bytes:
        return bytes(imagecodecs.lerc_encode(to_levels(ranges, max_error_m), level=0, compression="zstd"))

    def decode(data: bytes) -> Ranges:
        return from_levels(np.asarray(imagecodecs.lerc_decode(data), np.uint16), max_error_m)

    return Coder(encode, decode)


PEER = Peer("ranges", "max_error_m", BOUNDS_M, ("imagecodecs",), _make)
