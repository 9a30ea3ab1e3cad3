"""`peer:xz`: the raw packets of a frame, compressed with xz."""

from __future__ import annotations

import lzma

from lidarcodec.evaluation.peers.base import Coder, Peer


def _make(preset: float) -> Coder:
    return Coder(lambda data: lzma.compress(data, preset=int(preset)), lzma.decompress)


PEER = Peer("packets", "preset", (6,), (), _make)
