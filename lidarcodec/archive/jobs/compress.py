"""The job `compress`: encodes a segment of an input."""

from __future__ import annotations

from typing import Any

from lidarcodec.archive.jobs.reading import input_of, opened
from lidarcodec.archive.product import About, publish, write_product
from lidarcodec.archive.scratch import scratch_folder
from lidarcodec.archive.segments import Segment, packets_in
from lidarcodec.archive.stores.base import Store
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.settings import settings_from
from lidarcodec.sources.posed import with_poses


def compress(value: dict[str, Any], source: Store, target: Store) -> dict[str, Any]:
    """Encode a segment, decode it again, compare, and publish it.

    value: `input` (fields of Input), `origin` and `segment` (ids), `range` (fields of Segment), `vehicle`, `sensor`,
    `settings`, `not_kept`
    Raises SourceError, SettingsError, RoundTripError, OSError.
    """
    one, segment = input_of(value), Segment.of(value["range"])
    about = {
        "job": "compress",
        "input": one.name,
        "input_size": one.size,
        "input_tag": one.tag,
        "beside": [list(entry) for entry in one.beside],
        "range": segment.plain(),
        "not_kept": value["not_kept"],
    }
    known = About(value["vehicle"], value["sensor"], value["origin"], value["segment"], about)
    encoder = StreamEncoder(settings_from(value["settings"]), known.stream_id)
    with opened(source, one, posed=True) as packets, scratch_folder() as folder:
        encoder.prepare(packets.sensor)
        frames = frames_of(
            packets_in(packets.packets(), segment),
            packets.sensor,
            encoder.settings.framing,
            current=lambda: packets.sensor,
        )
        posed = with_poses(frames, packets.poses or packets.carried, packets.mount)
        product = write_product(posed, encoder, known, folder)
        won = publish(target, product)
    return {"won": won} | {name: product.value[name] for name in ("frames", "bytes", "packet_bytes")}
