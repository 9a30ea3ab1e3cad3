"""`peer:draco`: Google's Draco, its kd-tree coder at its best level. `bits` is the resolution of the longest side of
the cloud's bounding box.

It changes the order of the points, so the structure of the frame is lost: no rows, no columns, no packets.
"""

from __future__ import annotations

import DracoPy
import numpy as np

from lidarcodec.evaluation.peers.base import Coder, Floats, Peer


def _make(bits: float) -> Coder:
    def encode(points: Floats) -> bytes:
        data: bytes = DracoPy.encode(
            points.astype(np.float32), quantization_bits=int(bits), compression_level=10, preserve_order=False
        )
        return data

    def decode(data: bytes) -> Floats:
        points: Floats = np.asarray(DracoPy.decode(data).points, np.float64).reshape(-1, 3)
        return points

    return Coder(encode, decode)


PEER = Peer("x y z", "bits", (14, 13, 12, 11), ("DracoPy",), _make, ordered=False)
