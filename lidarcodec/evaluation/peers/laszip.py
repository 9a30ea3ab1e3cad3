"""`peer:laszip`: LASzip (lazrs): x y z of a LAS file with point format 0, as integer multiples of `scale_m`."""

from __future__ import annotations

from io import BytesIO

import laspy
import lazrs  # noqa: F401 (what laspy compresses with: its absence has to be seen here)
import numpy as np

from lidarcodec.evaluation.peers.base import Coder, Floats, Peer


def _make(scale_m: float) -> Coder:
    def encode(points: Floats) -> bytes:
        las = laspy.LasData(laspy.LasHeader(point_format=0, version="1.2"))
        las.header.scales, las.header.offsets = np.full(3, scale_m), np.zeros(3)
        las.x, las.y, las.z = points.T
        out = BytesIO()
        las.write(out, do_compress=True)
        return out.getvalue()

    def decode(data: bytes) -> Floats:
        points: Floats = np.asarray(laspy.read(BytesIO(data)).xyz, np.float64)
        return points

    return Coder(encode, decode)


PEER = Peer("x y z", "scale_m", (0.001, 0.02, 0.1, 0.4), ("laspy", "lazrs"), _make)
