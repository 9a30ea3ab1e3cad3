"""Bits of each frame of a drive at each setting of a codec: what the rate controller's first guesses and tests rest on.

    python -m benchmarks.rate_traces OUT.json [NAME=CAPTURE]...

writes {drive: {codec: {"points": [...], "intensity": [...], "rest": [...], "range": {value: [...]}}}},
where the lists have an entry a message, in bits but for the counts, and `value` is a bound in metres, a quality or
a crf. It also prints the bits per return of each value, the mean of all drives: the curves in the codecs' files.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

from lidarcodec import api
from lidarcodec.codecs import table
from lidarcodec.frame import Frame
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.units import RANGE_STEP_M
from lidarcodec.wire import pack

STEPS = (1, 3, 5, 11, 21, 51, 101, 251, 501, 1001, 2501, 5001, 10001, 20001)
QUALITIES = (1, 3, 5, 10, 20, 35, 50, 65, 80, 90, 95, 98, 100)
CRFS = tuple(range(51, -1, -3))
STORED = ("zstd", "pcodec", "jpeg")


def settings_of(codec: str) -> dict[float, StreamSettings]:
    """The settings to measure, by bound in metres, quality or crf."""
    if table.codec(codec).bounded:
        bounds = [(step - 1) // 2 * RANGE_STEP_M for step in STEPS]
        return {bound: StreamSettings(codec=codec, max_error_m=bound) for bound in bounds}
    name, values = ("crf", CRFS) if "crf" in table.codec(codec).settings.model_fields else ("quality", QUALITIES)
    return {value: StreamSettings(codec=codec, codec_settings={name: value}) for value in values}


def trace(frames: list[Frame], codec: str) -> dict[str, Any]:
    """Bits of each message by value, and what does not depend on it."""
    out: dict[str, Any] = {"range": {}}
    for value, settings in settings_of(codec).items():
        encoder = StreamEncoder(settings, stream_id=1)
        messages = [message for frame in frames for message in encoder.encode(frame)] + encoder.flush()
        ranges, intensity, rest, points = [], [], [], []
        at = 0
        for message in messages:
            by_type: dict[int, int] = defaultdict(int)
            for section in message.sections:
                by_type[section.type] += 8 * len(section.data)
            ranges.append(by_type[SectionType.RANGE])
            intensity.append(by_type[SectionType.INTENSITY])
            rest.append(8 * len(pack(message)) - ranges[-1] - intensity[-1])
            points.append(sum(frame.points for frame in frames[at : at + message.frame_count]))
            at += message.frame_count
        out |= {"intensity": intensity, "rest": rest, "points": points}
        out["range"][f"{value:g}"] = ranges
    return out


def main(arguments: list[str]) -> None:
    """Measure all codecs that have a bound or a quality."""
    drives = {name: list(api.read_frames(path)) for name, _, path in (a.partition("=") for a in arguments[1:])}
    codecs = [name for name in table.names() if name != "raw"]
    traces = {drive: {codec: trace(frames, codec) for codec in codecs} for drive, frames in drives.items()}
    for codec in codecs:
        print(codec)
        for value in settings_of(codec):
            key = f"{value:g}"
            each = [sum(t[codec]["range"][key]) / sum(t[codec]["points"]) for t in traces.values()]
            print(f"    ({key}, {sum(each) / len(each):.3f}),  # " + " ".join(f"{bits:.3f}" for bits in each))
    kept = {drive: {codec: of[codec] for codec in STORED} for drive, of in traces.items()}
    Path(arguments[0]).write_text(json.dumps(kept, separators=(",", ":")))


if __name__ == "__main__":
    main(sys.argv[1:])
