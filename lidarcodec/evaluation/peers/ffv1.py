"""`peer:ffv1`: the quantised range images as a video with FFV1 (FFmpeg): level 3, range coder, large contexts, 4
slices, statistics kept over ten frames."""

from __future__ import annotations

import struct
from fractions import Fraction
from typing import Literal

import av
import numpy as np

from lidarcodec.evaluation.peers.base import BOUNDS_M, Coder, Peer, Ranges, from_levels, to_levels

_HEAD = struct.Struct("<HIH")
_FORMAT = "gray16le"
_OPTIONS = {"level": "3", "coder": "range_tab", "context": "1", "slices": "4", "slicecrc": "0", "g": "10"}


class _Video:
    """An encoder and a decoder for images of one size. Another size begins a new video."""

    def __init__(self, max_error_m: float) -> None:
        self._bound = max_error_m
        self._shape: tuple[int, int] | None = None

    def encode(self, ranges: Ranges) -> bytes:
        levels = to_levels(ranges, self._bound)
        begins = levels.shape != self._shape
        if begins:
            self._writer = _context("w", levels.shape)
            self._writer.time_base, self._writer.options = Fraction(1, 10), _OPTIONS
            self._shape, self._next = (levels.shape[0], levels.shape[1]), 0
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(levels), format=_FORMAT)
        picture.pts = self._next
        self._next += 1
        packets = b"".join(bytes(packet) for packet in self._writer.encode(picture))
        head = self._writer.extradata or b"" if begins else b""
        return _HEAD.pack(*levels.shape, len(head)) + head + packets

    def decode(self, data: bytes) -> Ranges:
        rows, width, length = _HEAD.unpack_from(data)
        at = _HEAD.size + length
        if length:
            self._reader = _context("r", (rows, width))
            self._reader.extradata = data[_HEAD.size : at]
        (picture,) = self._reader.decode(av.Packet(data[at:]))
        return from_levels(picture.to_ndarray().astype(np.uint16, copy=False), self._bound)


def _context(mode: Literal["r", "w"], shape: tuple[int, ...]) -> av.VideoCodecContext:
    context = av.CodecContext.create("ffv1", mode)
    context.height, context.width, context.pix_fmt, context.thread_count = shape[0], shape[1], _FORMAT, 1
    return context


def _make(max_error_m: float) -> Coder:
    film = _Video(max_error_m)
    return Coder(film.encode, film.decode)


PEER = Peer("ranges", "max_error_m", BOUNDS_M, ("av",), _make)
