"""Prints, as Markdown, what a frame takes with each codec: the whole range path, and the image codec's share of it.

    python -m benchmarks.codec_times SOURCE [--frames 48] [--codecs jpeg,jxl] [--set intensity=off]

The path is that from a frame to the bytes of its messages and back, with canvas, holes and mask; intensity is off
unless it is set. Times are processor time of all threads, so that no codec hides behind a second core: the mean over
each group of 8 frames, as `jpeg-layered` sends them, and the median of the groups but the first, which warms up.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import import_module
from itertools import islice
from statistics import median
from time import process_time
from typing import Any
from unittest.mock import patch

from benchmarks.scenes import FRAMING
from lidarcodec import api
from lidarcodec.codecs import table
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import settings_from
from lidarcodec.wire import pack, unpack

IMAGE_CODECS = {
    "encode": (
        "lidarcodec._native:write_jpeg",
        "imagecodecs:jpeg8_encode",
        "imagecodecs:jpegxl_encode",
        "imagecodecs:png_encode",
        "lidarcodec.ranges.video.h264_stream:PictureWriter.write",
    ),
    "decode": (
        "imagecodecs:jpeg8_decode",
        "imagecodecs:jpegxl_decode",
        "lidarcodec.codecs.png:read_png",
        "lidarcodec.ranges.video.h264_stream:PictureReader.read",
    ),
}
"""What counts as the image codec: module and name of what turns samples into its bytes, or back."""
BUDGET_MS = {"jpeg": 10, "jpeg-layered": 10, "h264": 15, "h264-log": 15, "jxl": 8, "png": 25}
"""Encode and decode of a frame together, intensity off."""
GROUP = 8

Times = dict[str, float]


def _timed(times: Times, stage: str, call: Callable[..., Any], *given: Any, **named: Any) -> Any:
    started = process_time()
    result = call(*given, **named)
    times[stage] += process_time() - started
    return result


@contextmanager
def _watched(times: Times) -> Iterator[None]:
    """Adds the time in the image codecs' own functions; those that are not installed are left out."""
    with ExitStack() as stack:
        for stage, paths in IMAGE_CODECS.items():
            for path in paths:
                module, _, name = path.partition(":")
                try:
                    home = import_module(module)
                except ImportError:
                    continue
                owner, _, method = name.rpartition(".")
                if owner:
                    home = getattr(home, owner)
                call = getattr(home, method)
                if owner:

                    def bound(self: Any, *given: Any, _call: Any = call, _stage: str = stage, **named: Any) -> Any:
                        return _timed(times, f"image {_stage}", _call, self, *given, **named)

                    stack.enter_context(patch.object(home, method, bound))
                else:
                    stack.enter_context(patch.object(home, method, partial(_timed, times, f"image {stage}", call)))
        yield


def times_of(frames: list[Frame], codec: str, others: dict[str, str]) -> Times:
    """Milliseconds a frame of `encode`, `decode`, `image encode` and `image decode`.

    Raises AssertionError if frames do not come back: a time would mean nothing then.
    """
    encoder, decoder = StreamEncoder(settings_from({"intensity": "off", "codec": codec, **others})), StreamDecoder()
    times: Times = defaultdict(float)
    groups: list[Times] = []
    came = 0
    with _watched(times):
        for position, frame in enumerate(frames, 1):
            coded = _timed(times, "encode", lambda frame=frame: [pack(message) for message in encoder.encode(frame)])
            for data in coded:
                came += len(_timed(times, "decode", lambda data=data: decoder.decode(unpack(data))))
            if position % GROUP == 0:
                groups.append(dict(times))
                times.clear()
    assert came == len(frames), f"{came} of {len(frames)} frames came back"
    return {stage: median(1e3 * group.get(stage, 0.0) / GROUP for group in groups[1:]) for stage in groups[0]}


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source")
    parser.add_argument("--frames", type=int, default=6 * GROUP, help=f"in whole groups of {GROUP}, the first warms up")
    parser.add_argument("--codecs", default=",".join(table.names()))
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    frames = list(islice(api.read_frames(given.source, FRAMING), given.frames))
    frames = frames[: len(frames) // GROUP * GROUP]
    if len(frames) < 2 * GROUP:
        parser.error(f"{given.source} has fewer than {2 * GROUP} frames")
    others = dict(item.split("=", 1) for item in given.set)
    print("| codec | encode | of it the image codec | decode | of it the image codec | both | budget |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for codec in given.codecs.split(","):
        ms = defaultdict[str, float](float, times_of(frames, codec, others))
        both = ms["encode"] + ms["decode"]
        cells = [f"{ms[stage]:.1f}" for stage in ("encode", "image encode", "decode", "image decode")]
        print(f"| {codec} | {' | '.join(cells)} | {both:.1f} | {BUDGET_MS.get(codec, '')} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
