"""Cuts an input into segments, and keeps that as a plan in the archive."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from lidarcodec.archive.jobs.reading import input_of, named, opened
from lidarcodec.archive.names import PlanName, json_of
from lidarcodec.archive.segments import cut
from lidarcodec.archive.stores.base import Store
from lidarcodec.errors import SourceError
from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from lidarcodec.settings import settings_from
from lidarcodec.sources.unkept import apart, unkept


def cut_input(value: dict[str, Any], source: Store, target: Store) -> dict[str, Any]:
    """Create the plan of an input. value: `input` (fields of Input), `origin`, `settings`, `seconds`

    Returns the plan. Raises SourceError and others for an input that cannot be read.
    """
    one = input_of(value)
    if one.refused is not None:
        raise SourceError(one.refused)
    with opened(source, one) as packets:
        framing = settings_from(value["settings"]).framing
        frames = frames_of(
            packets.packets(),
            packets.sensor,
            framing,
            packets.counts,
            current=lambda: packets.sensor,
        )
        segments = list(cut(_sizes(frames), value["seconds"]))
        vehicle, sensor = named(packets, one)
        not_kept, in_part = apart(packets.counts)
        lost = [unkept(not_kept)]
        lost += ["the input is cut off or damaged"] * bool(packets.counts["truncated"] or packets.counts["damaged"])
    if not segments:
        raise SourceError("it has no frame")
    plan = {
        "input": one.identity(),
        "name": one.name,
        "vehicle": vehicle,
        "sensor": sensor,
        "settings": value["settings"],
        "seconds": value["seconds"],
        "segments": [segment.plain() for segment in segments],
        "not_kept": "; ".join(filter(None, [*lost, unkept(in_part)])) or None,
        "lost": "; ".join(filter(None, lost)) or None,  # the same without what the input itself has only in part
    }
    target.create(PlanName(one.name_id(), one.id(), value["origin"], len(segments)).object, json_of(plan))
    return plan


def _sizes(frames: Iterator[Frame]) -> Iterator[tuple[int, int]]:
    for frame in frames:
        yield frame.stamp_ns, 0 if frame.side is None else frame.side.packets
