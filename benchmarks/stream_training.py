"""Training in the stream: what a network learns from the first frames of a drive brings on those that come later.

    python -m benchmarks.stream_training [--drive 0005] [--learn 0:76] [--measure 80:153] [--every 8] [--steps 200]
                                         [--weights sim,kitti,FILE] [--effort 3] [--bounds 0,0.01,0.05]

An encoder codes all frames as a stream; so many steps are taken after each of the first. Every eighth of the later ones
is measured, in two ways: where it stands in the stream, and coded after its true previous frame by an encoder of its
own, as the tables of peers have it; with the weights as they were, and as they became. Bits are those of range, mask
and motion, and every measured frame is decoded. Updates of weights are told apart. What was learned is thrown away.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.range_table import COUNTED, DRIVES, OF_KITTI, OF_KITTI_VNNI
from benchmarks.scenes import DATA, FRAMING
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.network.networks import Weights
from lidarcodec.network.shelf import shipped
from lidarcodec.network.update import applied, is_update
from lidarcodec.network.weight_file import unpack_weights
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.wire import pack, unpack

WEIGHTS = {"sim": "", "kitti": OF_KITTI, "kitti-vnni": OF_KITTI_VNNI}


def frames(drive: str, most: int) -> list[Frame]:
    """Whole frames of a drive of the table of peers."""
    _, file, calibration = DRIVES[drive]
    spec = file if file.startswith("sim:") else str(DATA / file)
    with open_source(spec, calibration=None if calibration is None else DATA / calibration) as source:
        found = islice(frames_of(source.packets(), source.sensor, FRAMING), most)
        return [frame.with_(side=None) for frame in found if frame.side is None or frame.side.packets >= 300]


def settings(bound: float, effort: int, weights: str) -> StreamSettings:
    """Of the streams that are measured."""
    own = {"effort": effort, "weights": weights}
    return StreamSettings(codec="riddle", codec_settings=own, max_error_m=bound, intensity="off", key_interval=100_000)


class Streamed(NamedTuple):
    """bits: a return, of the measured frames; weights: those at the end, None: as it began; report: of learning"""

    bits: float
    weights: Weights | None
    report: dict[str, Any]


def counted(messages: Iterable[Message]) -> int:
    """Bits of range, mask and motion."""
    return 8 * sum(len(part.data) for message in messages for part in message.sections if part.type in COUNTED)


def streamed(given: StreamSettings, drive: Sequence[Frame], learn: range, measure: range, steps: int) -> Streamed:
    """All frames as one stream, which learns from some of them."""
    encoder, known = StreamEncoder(given, stream_id=1), dict(shipped())
    found: Weights | None = None
    bits = points = 0
    for number, frame in enumerate(drive):
        if steps and number == learn.start:
            encoder.learn(0)
        messages = encoder.encode(frame)
        for part in (part for message in messages for part in message.sections if part.type == SectionType.WEIGHTS):
            found = applied(part.data, known.__getitem__) if is_update(part.data) else unpack_weights(part.data)
            known[found.name] = found
        if steps and number in learn:
            encoder.learn(steps)
        if number in measure:
            bits, points = bits + counted(messages), points + frame.points
    report = encoder.learned or {}
    return Streamed(bits / points, found if report.get("update_bytes") else None, report)


def alone(given: StreamSettings, drive: Sequence[Frame], measure: range) -> float:
    """Bits a return of frames that are coded after the one before by encoders of their own."""
    bits = points = 0
    for number in measure:
        encoder, decoder = StreamEncoder(given, stream_id=1), StreamDecoder()
        for message in encoder.encode(drive[number - 1]):
            decoder.decode(unpack(pack(message)))
        messages = encoder.encode(drive[number])
        bits, points = bits + counted(messages), points + drive[number].points
        (came,) = [frame for message in messages for frame in decoder.decode(unpack(pack(message)))]
        if np.abs(came.range.astype(int) - drive[number].range).max() * 0.002 > (given.max_error_m or 0) + 1e-9:
            raise AssertionError("a bound is broken")
    return bits / points


def after(weights: Weights | None, given: StreamSettings, drive: Sequence[Frame], measure: range) -> float:
    """The same with other weights."""
    if weights is None:
        return alone(given, drive, measure)
    with tempfile.NamedTemporaryFile(suffix=".lcrw") as file:
        Path(file.name).write_bytes(weights.data)
        own = {**given.codec_settings, "weights": file.name}
        return alone(given.changed(codec_settings=own), drive, measure)


def span(text: str) -> range:
    """`first:last` of frames."""
    first, _, last = text.partition(":")
    return range(int(first), int(last))


def main() -> int:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.stream_training", description=__doc__)
    parser.add_argument("--drive", default="0005", help="of " + ", ".join(DRIVES))
    parser.add_argument("--learn", type=span, default=range(76), help="frames to learn from")
    parser.add_argument("--measure", type=span, default=range(80, 153), help="frames to measure on")
    parser.add_argument("--every", type=int, default=8, help="which of them")
    parser.add_argument("--steps", type=int, default=200, help="after each frame")
    parser.add_argument("--weights", default="sim,kitti", help="to begin with: files, or " + ", ".join(WEIGHTS))
    parser.add_argument("--effort", type=int, default=3)
    parser.add_argument("--bounds", default="0,0.01,0.05")
    chosen = parser.parse_args()
    drive = frames(chosen.drive, max(chosen.learn.stop, chosen.measure.stop))
    measure = range(chosen.measure.start, min(chosen.measure.stop, len(drive)), chosen.every)
    head = "weights | bound, m | alone | learned | in the stream | learned | update, bytes | updates"
    print(f"| {head} |\n|---|---{'|---:' * 6}|")
    for name in chosen.weights.split(","):
        for bound in map(float, chosen.bounds.split(",")):
            given = settings(bound, chosen.effort, WEIGHTS.get(name, name))
            plain = streamed(given, drive, chosen.learn, measure, 0)
            found = streamed(given, drive, chosen.learn, measure, chosen.steps)
            bits = (alone(given, drive, measure), after(found.weights, given, drive, measure), plain.bits, found.bits)
            report = (found.report.get(key, 0) for key in ("update_bytes", "updates"))
            cells = (Path(name).name, f"{bound:g}", *(f"{value:.3f}" for value in bits), *map(str, report))
            print(f"| {' | '.join(cells)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
