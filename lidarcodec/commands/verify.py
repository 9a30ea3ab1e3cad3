"""`lidarcodec verify`: checks whether a recording keeps the error bounds of its settings."""

from __future__ import annotations

import logging
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from lidarcodec.commands.progress import progress
from lidarcodec.commands.running.stopping import StoppedError, Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.sources import check_recorded
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.evaluation.sent import OFF, Sent, bounds_text
from lidarcodec.evaluation.verdict import broken_promises, changed_since_the_start, missing_parts
from lidarcodec.evaluation.verify import Comparison, Coverage, PacketsByTime, promise_of, promise_refined
from lidarcodec.recording.layer_counts import LAYERS
from lidarcodec.sensors.models.table import aside_name
from lidarcodec.sources import open_source
from lidarcodec.sources.unkept import OF_THE_SENSOR, say_unkept, unkept

logger = logging.getLogger(__name__)

OF_THE_SOURCE: Final = "the source"
"""So begin sentences about the source alone."""


def run(recording: Path, spec: str, calibration: Path | None, as_json: bool, allow_part: bool = False) -> bool:
    """Compare and print. Returns whether every promised bound was kept and no part of the source is missing.

    allow_part: whether the recording may contain only a part of its source
    """
    with progress("comparing") as tick, stoppable() as stopped:
        result = compared(recording, spec, calibration, allow_part, tick, stopped)
    with suppress(BrokenPipeError):  # the reader has closed the output, but the exit code still counts
        tell(result, _text(result), as_json)
        sys.stdout.flush()
    if result["interrupted"]:
        raise StoppedError(f"stopped: only the first {result['frames']} frames of {recording} were compared")
    return not result["broken"]


def verify(
    recording: str | Path, source: str | Path, *, calibration: Path | None = None, allow_part: bool = False
) -> dict[str, Any]:
    """What `lidarcodec verify --json` prints: how far a recording is from the source it was made of.

    `broken` is a list of sentences, empty if all that its messages promise is kept. `packets_identical`, `max_error_m`,
    `rmse_m`, `lost`, `invented` and `coverage` are among the others. allow_part: the recording may hold only a part of
    its source
    Raises SourceError if one of them cannot be read, or the recording was not made from this source.
    """
    return compared(Path(recording), str(source), calibration, allow_part)


def compared(
    recording: Path,
    spec: str,
    calibration: Path | None,
    allow_part: bool,
    tick: Callable[[], None] = lambda: None,
    stopped: Callable[[], bool] = lambda: False,
) -> dict[str, Any]:
    """The result of comparing a recording with its source. tick: called after each frame;  stopped: whether to end

    Raises SourceError, and StoppedError if it was stopped before the first frame.
    """
    check_recorded(spec)
    recorded = RecordedFrames(recording, ": `verify` takes the recording first, then its source")
    settings = recorded.settings()
    comparison, sent = Comparison(), Sent()
    with open_source(spec, calibration=calibration, points=False) as source:
        packets = PacketsByTime(source.packets())
        watched, added, lacking = Watched(recorded, stopped), None, Counter[str]()
        for frame in watched:
            message = recorded.message
            if message is not None and message is not added:  # one of a group has several frames
                sent.add(message)
                added = message
            promise = None if message is None else promise_refined(promise_of(message), recorded.refined)
            # A message of `raw` does not say that it is reduced.
            if promise is not None and settings is not None and settings.codec == "raw":
                promise = promise._replace(reduced=settings.reduces)
            comparison.add(frame, packets, promise)
            if frame.pose is None and source.carried is not None and source.carried.at(frame.stamp_ns) is not None:
                lacking["pose"] += 1
            if frame.mount is None and source.mount is not None:
                lacking["mounting of the sensor"] += 1
            tick()
        comparison.finish(packets)
        coverage = None if watched.cut else packets.coverage(stopped)
    for text in recorded.warnings():
        logger.warning("%s", text)
    say_unkept(spec, source.counts)
    if coverage is None and not comparison.frames:
        raise StoppedError(f"stopped before the first frame of {recording} was compared")
    if not comparison.frames:
        raise SourceError(f"{recording} has no frame that can be decoded: nothing can be compared")
    if comparison.not_in_source == comparison.frames:
        raise SourceError(
            f"{spec} has no packet with a time of {recording}: the recording was not made from this source"
        )
    incomplete = (
        []
        if coverage is None or allow_part
        else [*not_covered(coverage), *not_carried(lacking), *not_given(source.counts)]
    )
    broken = [*missing_parts(recorded), *broken_promises(settings, comparison), *incomplete]
    return comparison.result() | {
        "model": source.sensor.model,
        "complete": coverage is not None,
        "interrupted": coverage is None,
        "coverage": None if coverage is None else coverage.result(),
        "packets_passed_over": packets.passed,
        "layers": {name: recorded.layers[name] for name in LAYERS} if recorded.layers else None,
        "settings": None if settings is None else settings.model_dump(mode="json"),
        "changed": changed_since_the_start(settings, comparison),
        "sent": sent.result(),
        "short_turns": sum(row.missing > 0 for row in comparison.short.rows()),
        "source_lacks": comparison.short.text(),
        "broken": broken,
        "incomplete": incomplete,
    }


def not_covered(found: Coverage) -> list[str]:
    """Packets of the source that are not in the recording, as a sentence."""
    if found.whole:
        return []
    missing = found.source_packets - found.packets
    return [
        f"{missing:,} of {found.source_packets:,} packets of the source are missing; use --allow-part if only a "
        "part was recorded"
    ]


def not_carried(lacking: Counter[str]) -> list[str]:
    """What frames of the source carry beside their packets, and those of the recording do not, in sentences."""
    return [
        f"{count} frames lack the {name} that they have in the source; use --allow-part if that is known"
        for name, count in lacking.items()
    ]


def not_given(counts: Counter[str]) -> list[str]:
    """Data that the source did not give, because it is damaged or of another kind. No recording of it can have it."""
    broken = []
    if counts["truncated"] or counts["damaged"]:
        broken.append(
            f"{OF_THE_SOURCE} itself is cut off or damaged, which says nothing against the recording: it was compared "
            "with what is left; use --allow-part if that is known"
        )
    left = unkept(Counter({cause: counts[cause] for cause in OF_THE_SENSOR}))
    if left is not None:
        broken.append(f"{OF_THE_SOURCE} holds data that was not kept: {left}; use --allow-part if that is known")
    return broken


def _text(result: dict[str, Any]) -> str:
    def metres(value: float | None) -> str:
        return "nothing to compare" if value is None else f"{value:.6f} m"

    recorded, missing = result["position_packets"], result["position_packets_missing"]
    all_same = result["position_packets_identical"]
    same_positions = "identical" if all_same else f"{result['identical_position_packets']} identical, {missing} missing"
    strange = result["frames_not_in_source"]
    bound = f" (allowed: {bounds_text(result['sent'])})" if any(result["sent"]["intensity"]) else ""
    lines = [
        _covered_text(result["coverage"]),
        f"frames           {result['frames']:,}" + f", {strange} of them not in the source" * bool(strange),
        f"packets          {_packets_text(result)}",
        *([f"{aside_name(result['model']) + 's':16} {recorded}, {same_positions}"] if recorded or missing else []),
        f"largest error    {metres(result['max_error_m'])}{bound}",
        f"RMS error        {metres(result['rmse_m'])}",
        f"returns          {_returns_text(result)}",
        *_intensity_lines(result),
        *([_layers_text(result["layers"])] if result["layers"] else []),
        *([f"source           {result['source_lacks']}"] if result["source_lacks"] else []),
        *(f"changed          {text}" for text in result["changed"]),
        *(f"BROKEN           {text}" for text in result["broken"] if text not in result["incomplete"]),
        *(f"INCOMPLETE       {text}" for text in result["incomplete"]),
    ]
    if len(result["broken"]) == len(result["incomplete"]) and any(result["sent"]["intensity"]):
        lines.append("kept             all that its messages promise" + " so far" * bool(result["interrupted"]))
    return "\n".join(lines)


def _packets_text(result: dict[str, Any]) -> str:
    count, same = result["packets"], result["identical_packets"]
    if result["packets_identical"]:
        return f"{count:,}, identical"
    if any(not text.startswith(OF_THE_SOURCE) for text in result["broken"]):
        return f"{count:,}, {same:,} identical"
    some = f"{same:,} identical, the others" if same else "all of them"
    return f"{count:,}, {some} sent with losses, as the settings allow"


def _returns_text(result: dict[str, Any]) -> str:
    share = result["returns_percent"]
    kept = "" if share is None else f", {share:g} % kept"
    left = f", {result['left_out']:,} left out by the reduction" * bool(result["left_out"])
    points = result["points"] + result["left_out"]
    return f"{points:,}{kept}{left}, {result['lost']:,} lost, {result['invented']:,} invented"


def _intensity_lines(result: dict[str, Any]) -> list[str]:
    largest = result["intensity_max"]
    if largest is None:
        return []
    if largest and set(result["sent"]["intensity"]) == {OFF}:
        return ["intensity        not sent: 0 everywhere"]
    off = f"largest difference {largest}, mean {result['intensity_mean']:.2f}" if largest else "identical"
    return [f"intensity        {off}"]


def _layers_text(layers: dict[str, int]) -> str:
    return f"refined          {layers['whole']} frames whole, {layers['part']} in part, {layers['base']} base only"


def _covered_text(found: dict[str, Any] | None) -> str:
    if found is None:
        return "INTERRUPTED      only a part was compared; the results are of this part"
    if found["whole"]:
        return f"covered          the whole source: {found['source_packets']:,} packets"
    if found["first"] is None:
        return f"covered          nothing of the {found['source_packets']:,} packets of the source"
    begin, end = ((found[name] - found["source_first_ns"]) / 1e9 for name in ("first_ns", "last_ns"))
    gaps = f", with {found['gaps']} gaps" if found["gaps"] else ""
    return (
        f"covered          {found['packets']:,} of {found['source_packets']:,} packets of the source"
        f", number {found['first']:,} to"
        f" {found['last']:,}, second {begin:.1f} to {end:.1f}{gaps}"
    )
