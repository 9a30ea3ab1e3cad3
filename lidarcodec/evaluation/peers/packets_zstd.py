"""`peer:zstd`: the raw packets of a frame, compressed with zstd."""

from __future__ import annotations

import zstandard

from lidarcodec.evaluation.peers.base import Coder, Peer


def _make(level: float) -> Coder:
    return Coder(zstandard.ZstdCompressor(level=int(level)).compress, zstandard.ZstdDecompressor().decompress)


PEER = Peer("packets", "level", (3, 19), ("zstandard",), _make)
