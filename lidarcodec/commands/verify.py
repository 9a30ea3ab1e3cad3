"""`lidarcodec verify`: checks whether a recording keeps the error bounds of its settings."""

from __future__ import annotations

import logging
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from lidarcodec.codecs import table
from lidarcodec.commands.progress import progress
from lidarcodec.commands.recorded import RecordedFrames
from lidarcodec.commands.running.stopping import StoppedError, Watched, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.sources import check_recorded
from lidarcodec.commands.unkept import say_unkept
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.verify import Comparison, Coverage, PacketsByTime, bound_of, promise_of
from lidarcodec.settings import StreamSettings, step_of
from lidarcodec.sources import open_source
from lidarcodec.sources.unkept import OF_THE_SENSOR, unkept

log = logging.getLogger(__name__)


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
    recorded = RecordedFrames(recording)
    settings = recorded.settings()
    comparison = Comparison()
    with open_source(spec, calibration=calibration) as source:
        packets = PacketsByTime(source.packets())
        watched = Watched(recorded, stopped)
        for frame in watched:
            message = recorded.message
            promise = None if message is None else promise_of(message)
            # A message of `raw` does not say that it is reduced.
            if promise is not None and settings is not None and settings.codec == "raw":
                promise = promise._replace(reduced=settings.reduces)
            comparison.add(frame, packets, promise)
            tick()
        comparison.finish(packets)
        coverage = None if watched.cut else packets.coverage(stopped)
    for text in recorded.warnings():
        log.warning("%s", text)
    say_unkept(spec, source.counts)
    if coverage is None and not comparison.frames:
        raise StoppedError(f"stopped before the first frame of {recording} was compared")
    if not comparison.frames:
        raise SourceError(f"{recording} has no frame that can be decoded: nothing can be compared")
    if comparison.not_in_source == comparison.frames:
        raise SourceError(
            f"{spec} has no packet with a time of {recording}: the recording was not made from this source"
        )
    broken = [
        *missing_parts(recorded),
        *broken_promises(settings, comparison),
        *([] if coverage is None or allow_part else not_covered(coverage) + not_given(source.counts)),
    ]
    return comparison.result() | {
        "complete": coverage is not None,
        "interrupted": coverage is None,
        "coverage": None if coverage is None else coverage.result(),
        "packets_passed_over": packets.passed,
        "settings": None if settings is None else settings.model_dump(mode="json"),
        "changed": changed_since_the_start(settings, comparison),
        "broken": broken,
    }


def not_covered(found: Coverage) -> list[str]:
    """Packets of the source that are not in the recording, as a sentence."""
    if found.whole:
        return []
    missing = found.source_packets - found.packets
    return [
        f"{missing} of {found.source_packets} packets of the source are missing; use --allow-part if only a "
        "part was recorded"
    ]


def not_given(counts: Counter[str]) -> list[str]:
    """Data that the source did not give, because it is damaged or of another kind. No recording of it can have it."""
    broken = []
    if counts["truncated"] or counts["damaged"]:
        broken.append("the source itself is cut off or damaged; use --allow-part if that is known")
    left = unkept(Counter({cause: counts[cause] for cause in OF_THE_SENSOR}))
    if left is not None:
        broken.append(f"the source holds data that was not kept: {left}; use --allow-part if that is known")
    return broken


def missing_parts(recorded: RecordedFrames) -> list[str]:
    """Parts of the recording that cannot be compared, one sentence each."""
    missing = []
    if failed := sum(recorded.failed.values()):
        missing.append(f"{failed} messages could not be decoded")
    if recorded.counts["damaged"]:
        missing.append(f"{recorded.counts['damaged']} parts of the recording are damaged and were left out")
    if recorded.counts["cut"]:
        missing.append("the end of the recording is missing")
    return missing


def broken_promises(settings: StreamSettings | None, found: Comparison) -> list[str]:
    """Bounds in the messages that their frames exceed, one sentence each. Frames without a message (recorded
    packets) are checked against the settings in the metadata."""
    broken = []
    if found.not_in_source:
        broken.append(f"{found.not_in_source} frames are not in the source")
    if found.beyond:
        broken.append(
            f"{found.beyond} frames have larger errors than their messages allow, by up to {found.beyond_m:.3f} m"
        )
    if found.differing:
        broken.append(f"{found.differing} packets differ, although their messages promise exact packets")
    broken += [f"{count} frames have {what}" for what, count in found.others.items()]
    broken += broken_positions(found)
    if not found.steps:
        return broken + _broken_settings(settings, found)
    if None not in found.steps and (found.errors.lost or found.errors.invented):
        broken.append(f"{found.errors.lost} returns were lost and {found.errors.invented} were added")
    if settings is not None and settings.codec == "raw":
        broken += _broken_settings(settings, found) if set(found.steps) == {1} else []
    return broken


def broken_positions(found: Comparison) -> list[str]:
    """Differences of position packets, one sentence each. Every message has them byte for byte."""
    positions, broken = found.positions, []
    if differing := positions.recorded - positions.identical:
        broken.append(f"{differing} position packets differ from those of the source")
    if positions.missing:
        broken.append(f"{positions.missing} position packets of the source are missing")
    return broken


def changed_since_the_start(settings: StreamSettings | None, found: Comparison) -> list[str]:
    """Differences between the messages and the settings at the start of the recording, one sentence each. Somebody
    changed the settings while the stream ran, or a target bitrate changed the bound. This breaks no promise."""
    if settings is None or settings.target_kbps is not None or not table.codec(settings.codec).bounded:
        return []
    step_m = found.errors.range_step_m
    noted = step_of(settings.max_error_m or 0.0, step_m)
    changed = []
    if unbounded := found.steps[None]:
        changed.append(f"{unbounded} frames come from a codec without an error bound")
    coarser = {step: count for step, count in found.steps.items() if step is not None and step > noted}
    if coarser:
        changed.append(
            f"{sum(coarser.values())} frames have an error bound of up to {bound_of(max(coarser), step_m):.3f} m"
        )
    return [f"{text}; the recording began with {bound_of(noted, step_m):.3f} m" for text in changed]


def _broken_settings(settings: StreamSettings | None, found: Comparison) -> list[str]:
    broken: list[str] = []
    if settings is None or not table.codec(settings.codec).bounded:
        return broken
    bound_m = settings.max_error_m or 0.0
    worst_m = found.errors.max_error_m
    if worst_m is not None and worst_m > bound_m + 1e-9:
        broken.append(f"the largest error is {worst_m:.3f} m, the bound is {bound_m:.3f} m")
    if found.errors.lost or found.errors.invented:
        broken.append(f"{found.errors.lost} returns were lost and {found.errors.invented} were added")
    whole = settings.step == 1 and settings.intensity_levels == 256 and not settings.reduces
    if whole and not found.packets_identical:
        broken.append(f"only {found.identical_packets} of {found.packets} packets are identical")
    return broken


def _text(result: dict[str, Any]) -> str:
    def metres(value: float | None) -> str:
        return "nothing to compare" if value is None else f"{value:.6f} m"

    same = "identical" if result["packets_identical"] else f"{result['identical_packets']} identical"
    recorded, missing = result["position_packets"], result["position_packets_missing"]
    all_same = result["position_packets_identical"]
    same_positions = "identical" if all_same else f"{result['identical_position_packets']} identical, {missing} missing"
    lines = [
        _covered_text(result["coverage"]),
        f"frames           {result['frames']}, {result['frames_not_in_source']} of them not in the source",
        f"packets          {result['packets']}, {same}",
        *([f"position packets {recorded}, {same_positions}"] if recorded or missing else []),
        f"largest error    {metres(result['max_error_m'])}",
        f"RMS error        {metres(result['rmse_m'])}",
        f"returns          {result['points']:,}, {result['lost']} lost, {result['invented']} invented"
        + (f", {result['left_out']:,} left out by the reduction" if result["left_out"] else ""),
        *(f"changed          {text}" for text in result["changed"]),
        *(f"BROKEN           {text}" for text in result["broken"]),
    ]
    return "\n".join(lines)


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
        f" ({found['frames']:.1f} of {found['source_frames']:.1f} frames), number {found['first']:,} to"
        f" {found['last']:,}, second {begin:.1f} to {end:.1f}{gaps}"
    )
