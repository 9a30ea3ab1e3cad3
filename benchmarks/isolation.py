"""What a process of its own costs a codec: median milliseconds a frame, in this process and in another.

python -m benchmarks.isolation [--codec pcodec] [--source sim:city] [--frames 40]
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import lidarcodec
from benchmarks.scenes import FRAMING
from lidarcodec.apps.worker.isolation import Isolation
from lidarcodec.codecs import table


def median_ms(code: Callable[[Any], object], values: Sequence[Any]) -> float:
    """The median of what coding each of them takes."""
    taken = []
    for value in values:
        start = time.perf_counter()
        code(value)
        taken.append(1e3 * (time.perf_counter() - start))
    return statistics.median(taken)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--codec", default="pcodec")
    parser.add_argument("--source", default="sim:city")
    parser.add_argument("--frames", type=int, default=40)
    given = parser.parse_args()
    settings = lidarcodec.StreamSettings(codec=given.codec)
    with lidarcodec.open_source(given.source) as source:
        frames = [frame for frame, _ in zip(lidarcodec.read_frames(source, FRAMING), range(given.frames), strict=False)]
    for name, choice in (("in this process", "never"), ("in a process of its own", "always")):
        sender, receiver = (Isolation(choice, print) for _ in range(2))
        encoder, decoder = sender.make_encoder(settings, 1), receiver.make_decoder(table.codec_id(given.codec))
        messages = [message for frame in frames for message in encoder.encode(frame, key=True)]
        for message in messages:
            decoder.decode(message)
        encode = median_ms(partial(encoder.encode, key=True), frames)
        decode = median_ms(decoder.decode, messages)
        print(f"{given.codec} {name:<24} encode {encode:6.2f} ms   decode {decode:6.2f} ms")
        sender.close()
        receiver.close()


if __name__ == "__main__":
    main()
