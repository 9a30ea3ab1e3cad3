"""Test vectors of other sensors than the HDL-64E: their streams, and what every message must become."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.packet_rest import PacketRest
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.planes.plane_section import read_head
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import settings_from
from lidarcodec_server.live.ring_geometry import ring_geometry, shown_ranges, shown_step
from tests.contracts import frames
from tests.sensors.made_frames import block_sensor, made_frames, ouster
from tests.vectors.digest import digest

STREAM = 0x0FED_CBA9_8765_4321
FRAMES = 10


class Stream(NamedTuple):
    """Frames of a sensor and layout, so many packets each, and the settings that they are sent with."""

    sensor: SensorModel
    layout: str
    packets: int
    settings: dict[str, Any]


DUAL = ouster("RNG19_RFL8_SIG16_NIR16_DUAL", 32, "OS-0-32")
DUAL_LAYOUT = "rng19_rfl8_sig16_nir16_dual"
STREAMS = {
    "other_raw_vlp16": Stream(block_sensor("vlp16"), "single", 1, {"codec": "raw"}),
    "other_zstd_vlp16": Stream(block_sensor("vlp16"), "dual", 1, {"codec": "zstd"}),
    "other_zstd_vls128": Stream(block_sensor("vls128"), "single", 1, {"codec": "zstd", "max_error_m": 0.02}),
    "other_zstd_pandar64": Stream(block_sensor("pandar64"), "dual", 1, {"codec": "zstd", "intensity": "off"}),
    "other_pcodec_xt32": Stream(block_sensor("xt32"), "dual", 1, {"codec": "pcodec"}),
    "other_riddle_xt32": Stream(block_sensor("xt32"), "dual", 1, {"codec": "riddle"}),
    "other_predictive_vls128": Stream(block_sensor("vls128"), "dual", 1, {"codec": "predictive"}),
    "other_png_vlp16": Stream(
        block_sensor("vlp16"), "dual", 1, {"codec": "png", "intensity": "levels=3", "key_interval": 20}
    ),
    "other_png_xt32": Stream(
        block_sensor("xt32"), "single", 1, {"codec": "png", "max_error_m": 0.05, "intensity": "off", "key_interval": 20}
    ),
    "other_png_os0-16": Stream(
        ouster("RNG19_RFL8_SIG16_NIR16_DUAL", 16, "OS-0-16"),
        DUAL_LAYOUT,
        1,
        {"codec": "png", "reduction": "lattice:7", "intensity": "off", "key_interval": 20},
    ),
    "other_zstd_os1-128": Stream(
        ouster("RNG15_RFL8_NIR8", 128, "OS-1-128"),
        "rng15_rfl8_nir8",
        1,
        {"codec": "zstd", "reduction": "lattice:8", "intensity": "levels=16"},
    ),
    "other_zstd_os0-32": Stream(DUAL, DUAL_LAYOUT, 1, {"codec": "zstd"}),
    "other_predictive_os0-32": Stream(
        DUAL, DUAL_LAYOUT, 1, {"codec": "predictive", "intensity": "error=8", "max_error_m": 0.05}
    ),
}


def messages_of(stream: Stream) -> list[Message]:
    """The messages of a stream; one frame has a pose."""
    encoder = StreamEncoder(settings_from({"key_interval": 4, **stream.settings}), STREAM)
    sent = made_frames(stream.sensor, stream.layout, stream.packets, FRAMES)
    sent[1] = sent[1].with_(pose=frames.pose())
    return [message for frame in sent for message in encoder.encode(frame)]


def message_has_attributes(message: Message) -> bool:
    """Whether a message has more planes than ranges."""
    return any(form.role == "attribute" for form in read_head(message.section(SectionType.PLANES)).forms)


def expected_of_other(frame: Frame, message: Message) -> dict[str, Any]:
    """What a decoder must find. Planes as u32, series as u64; points: the first, middle and last of both returns.

    `shown` is what viewers get: digests of ranges in 16 bits and intensities in 8, metres of a range step, and the
    geometry of the first, middle and last ring.
    """
    cloud, rest = frame.cloud("all"), frame.side
    assert isinstance(rest, PacketRest)
    ends = [cloud[at] for at in (0, len(cloud) // 2, len(cloud) - 1)] if len(cloud) else []
    planes = {"range": frame.range, "intensity": frame.intensity, **frame.planes}
    if not message_has_attributes(message):
        planes = {name: plane for name, plane in planes.items() if name.startswith("range")}
    geometry = ring_geometry(frame)
    rings = (0, frame.sensor.rows // 2, frame.sensor.rows - 1)
    return {
        "stream": str(message.stream_id),
        "index": str(frame.index),
        "stamp_ns": str(frame.stamp_ns),
        "sensor": [frame.sensor.name, frame.sensor.hash, frame.sensor.convention, frame.sensor.range_step_m],
        "model": frame.sensor.model,
        "rows": frame.sensor.rows,
        "width": frame.width,
        "returns": int(np.count_nonzero(frame.valid)),
        "planes": {name: digest(plane.astype(np.uint32)) for name, plane in sorted(planes.items())},
        "azimuth": digest(frame.azimuth[0]),
        "lattice": None if frame.lattice is None else digest(frame.lattice.astype(np.uint16)),
        "layout": rest.layout,
        "packet_ns": digest(rest.packet_ns),
        "odd": rest.odd.tolist(),
        "series": {name: digest(values.astype(np.uint64)) for name, values in sorted(rest.series.items())},
        "pose": None if frame.pose is None else frame.pose[:3].ravel().tolist(),
        "points": [
            [round(float(one[axis]), 4) for axis in "xyz"]
            + [int(one[name]) for name in ("intensity", "ring", "return_number")]
            + [str(one["t_ns"])]
            for one in ends
        ],
        "cloud": len(cloud),
        "shown": {
            "range": digest(shown_ranges(frame)),
            "intensity": digest(np.minimum(frame.intensity, 255).astype(np.uint8)),
            "range_step_m": frame.sensor.range_step_m * shown_step(frame),
            "rings": None if geometry is None else [[round(float(one[at]), 9) for one in geometry] for at in rings],
        },
    }
