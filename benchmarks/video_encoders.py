"""Prints, as Markdown, what video encoders take of the same pictures at equal error, and how long.

    python -m benchmarks.video_encoders NAME=SOURCE... [--frames 16] [--only libx264]

Pictures are those of `h264`: the canvas of a turn, linear samples, holes filled with lines. Each encoder runs on one
core, without delay, a key picture first and then each from the one before. Bits a point are of the pictures alone,
interpolated between qualities (`-` where an encoder does not get there); times are processor time, medians.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from fractions import Fraction
from typing import NamedTuple

import av
import numpy as np

from benchmarks.scenes import FRAMING
from lidarcodec import api
from lidarcodec.frame import Frame
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.ranges.image.holes import filled_lines
from lidarcodec.ranges.mapping import mapping_of
from lidarcodec.ranges.video.turn_canvas import TurnLayout, cells, positions

TOP = 40_960
ERRORS_M = (0.1, 0.2, 0.4)
X264 = "scenecut=0:keyint=infinite:no-psy=1:aq-mode=0:qcomp=1"
X265 = "log-level=none:pools=none:frame-threads=1:scenecut=0:keyint=-1:bframes=0:rc-lookahead=0:psy-rd=0:psy-rdoq=0"
X265 += ":aq-mode=0:cutree=0:repeat-headers=1:info=0:qcomp=1"
SVT = "lp=1:pred-struct=1:lookahead=0:scd=0:keyint=-1:enable-tf=0:aq-mode=0:tune=1"


class Encoder(NamedTuple):
    """A way to encode: codec, pixel format, bits, options, option of the quality and its values, and its decoder."""

    codec: str
    pixels: str
    bits: int
    options: dict[str, str]
    qualities: tuple[int, ...]
    decoder: str


def x264(preset: str) -> Encoder:
    """libx264 as `h264` uses it."""
    options = {"preset": preset, "tune": "zerolatency", "x264-params": X264}
    return Encoder("libx264", "gray10le", 10, options, (2, 6, 12, 18, 24), "h264")


def x265(preset: str, bits: int) -> Encoder:
    """libx265, tuned alike."""
    options = {"preset": preset, "tune": "zerolatency", "x265-params": X265}
    return Encoder("libx265", f"gray{bits}le", bits, options, (2, 6, 12, 18, 24), "hevc")


def svt(preset: int) -> Encoder:
    """SVT-AV1, low delay."""
    options = {"preset": str(preset), "svtav1-params": SVT}
    return Encoder("libsvtav1", "yuv420p10le", 10, options, (1, 4, 10, 20, 35), "libdav1d")


ENCODERS = {
    **{f"libx264 {name}": x264(name) for name in ("veryfast", "fast", "medium")},
    **{f"libx265 {name}, {bits} bits": x265(name, bits) for bits in (10, 12) for name in ("ultrafast", "superfast")},
    "libx265 fast, 10 bits": x265("fast", 10),
    **{f"libsvtav1 {preset}": svt(preset) for preset in (12, 10, 8)},
}


class Picture(NamedTuple):
    """samples: unrounded, filled, of 0..1; where: index of each return; values: canvas values of the returns."""

    samples: np.ndarray
    where: np.ndarray
    values: np.ndarray


def pictures_of(frames: list[Frame]) -> Iterator[Picture]:
    """The pictures of a stream, on one layout."""
    layout = TurnLayout.fitting(frames[0].azimuth, frames[0].fired)
    for frame in frames:
        valid = frame.valid
        values = (frame.range + level_offsets(frame.sensor)[:, None])[valid]
        where = cells(layout, positions(layout, frame.azimuth, frame.fired), frame.sensor, valid)
        samples, known = np.zeros(layout.shape, np.float32), np.zeros(layout.shape, np.bool_)
        samples.reshape(-1)[where], known.reshape(-1)[where] = values / np.float32(TOP), True
        yield Picture(filled_lines(samples, known), where, values)


def samples_of(frame: av.VideoFrame, rows: int, columns: int) -> np.ndarray:
    """(rows, columns), the first plane of a decoded picture."""
    plane = frame.planes[0]
    return np.frombuffer(plane, "<u2").reshape(-1, plane.line_size // 2)[:rows, :columns].copy()


def run(encoder: Encoder, quality: int, pictures: list[Picture]) -> tuple[float, float, float, float]:
    """Bits a point, RMSE in metres, ms to encode, ms to decode a picture."""
    rows, columns = pictures[0].samples.shape
    peak = (1 << encoder.bits) - 1
    value_of = mapping_of("linear", encoder.bits, TOP).value
    writer = av.CodecContext.create(encoder.codec, "w")
    writer.width, writer.height, writer.pix_fmt = columns, rows, encoder.pixels
    writer.time_base, writer.framerate = Fraction(1, 10), Fraction(10, 1)
    writer.thread_count, writer.gop_size, writer.max_b_frames = 1, 10_000, 0
    writer.options = {**encoder.options, "crf": str(quality)}
    reader = av.CodecContext.create(encoder.decoder, "r")
    reader.thread_count = 1
    if encoder.decoder == "libdav1d":
        reader.options = {"max_frame_delay": "1"}
    size, encode_ms, decode_ms, came = 0, [], [], []

    def take(packets: list) -> None:
        nonlocal size
        for packet in packets:
            size += packet.size
            began = time.process_time()
            came.extend(samples_of(frame, rows, columns) for frame in reader.decode(packet))
            decode_ms.append(1e3 * (time.process_time() - began))

    for number, picture in enumerate(pictures):
        frame = av.VideoFrame(columns, rows, encoder.pixels)
        for plane in frame.planes:
            np.frombuffer(plane, "<u2")[:] = 1 << encoder.bits - 1
        np.frombuffer(frame.planes[0], "<u2").reshape(rows, -1)[:, :columns] = np.rint(picture.samples * peak)
        frame.pts = number
        began = time.process_time()
        packets = writer.encode(frame)
        encode_ms.append(1e3 * (time.process_time() - began))
        take(packets)
    take(writer.encode(None))
    came += [samples_of(frame, rows, columns) for frame in reader.decode(None)]
    squares = points = 0
    for picture, samples in zip(pictures, came, strict=True):
        error = value_of[np.minimum(samples.reshape(-1)[picture.where], peak)] - picture.values
        squares += float((error.astype(np.float64) ** 2).sum())
        points += len(error)
    return (
        8 * size / points,
        0.002 * (squares / points) ** 0.5,
        float(np.median(encode_ms)),
        float(np.median(decode_ms)),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+", metavar="NAME=SOURCE")
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    drives = {name: list(pictures_of(list(api.read_frames(spec, FRAMING))[: given.frames]))
              for name, _, spec in (source.partition("=") for source in given.sources)}  # fmt: skip
    titles = [f"{name} {100 * error:.0f} cm" for name in drives for error in ERRORS_M]
    print("| encoder | " + " | ".join(titles) + " | encode ms | decode ms |\n" + "|---" * (len(titles) + 3) + "|")
    for name, encoder in ENCODERS.items():
        if given.only not in name:
            continue
        row, encode_ms, decode_ms = [], [], []
        for pictures in drives.values():
            every = [run(encoder, quality, pictures) for quality in encoder.qualities]
            best = [one for one in every if not any(two[0] < one[0] and two[1] < one[1] for two in every)]
            runs = sorted(best, key=lambda one: one[1])
            errors = np.log([one[1] for one in runs])
            for error in ERRORS_M:
                inside = errors[0] <= np.log(error) <= errors[-1]
                row.append(f"{np.interp(np.log(error), errors, [r[0] for r in runs]):.2f}" if inside else "-")
            encode_ms += [one[2] for one in runs]
            decode_ms += [one[3] for one in runs]
        print(f"| {name} | " + " | ".join(row) + f" | {min(encode_ms):.1f} - {max(encode_ms):.1f}"
              f" | {max(decode_ms):.1f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
