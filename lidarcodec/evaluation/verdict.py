"""What a comparison of a recording with its source found, in sentences: broken promises, and missing parts."""

from __future__ import annotations

from lidarcodec.codecs import table
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.evaluation.verify import Comparison, bound_of
from lidarcodec.settings import StreamSettings, step_of


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
    if found.errors.lost or found.errors.invented:  # no codec does that, without a bound neither
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
    noted = step_of(settings.base.max_error_m or 0.0, step_m)
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
