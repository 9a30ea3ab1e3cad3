"""H.264 pictures of one plane, written by libx264 and read by FFmpeg: the only file that imports PyAV, on first use.

One picture in, one access unit out, without delay. An IDR picture is three NAL units (sequence and picture parameters,
one slice) and needs nothing before it; a P picture is one slice. Everything else that H.264 knows is left out by the
writer and refused by the reader before FFmpeg sees it (h264_units.py).
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import LidarCodecError, SectionError
from lidarcodec.ranges.video.h264_units import check_picture, without_remarks

Samples = npt.NDArray[np.uint16]
Preset = Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow"]
PRESETS: Final[tuple[Preset, ...]] = get_args(Preset)

_FORMATS: Final = {8: "gray", 10: "gray10le"}
_DECODED: Final = {8: ("gray", "yuv420p"), 10: ("gray10le", "yuv420p10le")}
"""FFmpeg may add planes of colour to a picture that has none."""
_DTYPES: Final[dict[int, np.dtype[Any]]] = {8: np.dtype(np.uint8), 10: np.dtype("<u2")}
_PARAMETERS: Final = "scenecut=0:keyint=infinite:no-psy=1:aq-mode=0:qcomp=1"
"""No key pictures but those asked for; nothing for the eye, which sees no range image; one quantiser for all pictures:
against x264's defaults 15 to 25 % fewer bits at equal RMSE (docs/codecs.md)."""

_FINEST: Final = 1.0
"""Below it x264 changes to the lossless pictures of another profile, with 8 bits."""
_ALIGNED: Final = 128
"""FFmpeg rounds sides up before it compares them with its limit."""


def _quiet() -> None:
    """Let FFmpeg print nothing about what it reads."""
    import av.logging

    av.logging.set_level(av.logging.PANIC)


class PictureWriter:
    """Pictures to access units. The first is an IDR picture."""

    def __init__(self, rows: int, columns: int, bits: int, crf: float, preset: Preset) -> None:
        """rows, columns: multiples of 16; bits: a sample, 8 or 10."""
        import av

        _quiet()
        self.shape, self._bits, self._count = (rows, columns), bits, 0
        crf = max(crf, _FINEST) if bits == 8 else crf
        context = av.CodecContext.create("libx264", "w")
        context.width, context.height, context.pix_fmt = columns, rows, _FORMATS[bits]
        context.time_base, context.framerate = Fraction(1, 10), Fraction(10, 1)
        context.thread_count, context.max_b_frames = 1, 0
        context.options = {"preset": preset, "tune": "zerolatency", "crf": f"{crf:g}", "x264-params": _PARAMETERS}
        self._context = context

    def write(self, samples: Samples, *, idr: bool) -> bytes:
        """The access unit of a picture, (rows, columns), 0..2^bits - 1.

        Raises LidarCodecError if libx264 does not give one.
        """
        import av
        from av.error import FFmpegError
        from av.video.frame import PictureType

        frame = av.VideoFrame(self.shape[1], self.shape[0], _FORMATS[self._bits])
        dtype = _DTYPES[self._bits]
        plane = np.frombuffer(memoryview(frame.planes[0]), dtype).reshape(self.shape[0], -1)
        plane[:, : self.shape[1]] = samples
        frame.pts, self._count = self._count, self._count + 1
        if idr:
            frame.pict_type = PictureType.I
        try:
            data = b"".join(bytes(packet) for packet in self._context.encode(frame))
            return without_remarks(data, idr=idr)
        except (FFmpegError, SectionError) as error:
            raise LidarCodecError(f"libx264 wrote no picture of {self.shape[1]} x {self.shape[0]}: {error}") from None


class PictureReader:
    """Access units to pictures, from an IDR picture on. After an error it is of no more use: make another."""

    def __init__(self, rows: int, columns: int, bits: int) -> None:
        import av

        _quiet()
        self.shape, self.bits = (rows, columns), bits
        context = av.CodecContext.create("h264", "r")
        context.thread_count = 1
        context.options = {
            "max_pixels": str((rows + _ALIGNED) * (columns + _ALIGNED)),
            "err_detect": "explode",
            "flags": "low_delay",
        }
        self._context = context

    def read(self, data: bytes, *, idr: bool) -> Samples:
        """(rows, columns) uint16, samples of an access unit, 0..2^bits - 1.

        Raises SectionError if it is damaged, or anything else than one picture of this size.
        """
        import av
        from av.error import FFmpegError

        check_picture(data, *self.shape, self.bits, idr=idr)
        try:
            frames = self._context.decode(av.Packet(data))
        except (FFmpegError, ValueError, MemoryError) as error:
            raise SectionError(f"damaged H.264 picture: {error}") from None
        if len(frames) != 1 or frames[0].is_corrupt:
            raise SectionError(f"an H.264 access unit that gives {len(frames)} whole pictures, not one")
        frame = frames[0]
        if (frame.height, frame.width) != self.shape or frame.format.name not in _DECODED[self.bits]:
            raise SectionError(f"an H.264 picture of {frame.width} x {frame.height} samples, {frame.format.name}")
        plane = frame.planes[0]
        dtype = _DTYPES[self.bits]
        samples = np.frombuffer(memoryview(plane), dtype).reshape(-1, plane.line_size // dtype.itemsize)
        out: Samples = samples[: self.shape[0], : self.shape[1]].astype(np.uint16)
        if int(out.max()) >> self.bits:
            raise SectionError(f"an H.264 picture with samples beyond {self.bits} bits")
        return out
