"""Captures of Ouster's sensors, metadata as their firmware writes it, and packets made of random bits."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarcodec.sensors.images import Images
from lidarcodec.sensors.models.ouster.fields import FUSA, PIXELS
from lidarcodec.sensors.models.ouster.layouts import ROWS, OusterLayout

FOLDER = "sensors/ouster"
CAPTURES = {
    "OS-0-32-U1_v2.2.0_1024x10": "OS-0-32-U1_v2.2.0_1024x10",
    "OS-1-128_767798045_1024x10_20230712_120049": "OS-1-128_767798045_1024x10_20230712_120049",
    "OS-1-128_v2.3.0_1024x10_lb_n3": "OS-1-128_v2.3.0_1024x10",
    "OS-1-32-G_v2.1.1_1024x10": "OS-1-32-G_v2.1.1_1024x10",
    "OS-1-64_1024x10_fw20": "OS-1-64_sensor_config_reduced",
    "OS-2-128-U1_v2.3.0_1024x10": "OS-2-128-U1_v2.3.0_1024x10",
    "shot_limiting_test": "shot_limiting_test",
    "windowed_frame1": "windowed_frame1_0",
}
"""Capture -> its metadata, both without ending."""
LAYOUTS = {
    f"{profile} {rows}": OusterLayout(profile, rows, fusa_head=profile == FUSA) for profile in PIXELS for rows in ROWS
}


def flat_metadata(profile: str = "RNG15_RFL8_NIR8", rows: int = 128, product: str = "OS-1-128") -> dict[str, Any]:
    """Metadata as firmware 2.x writes it."""
    return {
        "prod_line": product,
        "prod_sn": "122201000998",
        "lidar_mode": "1024x10",
        "beam_altitude_angles": np.linspace(21, -21, rows).round(2).tolist(),
        "beam_azimuth_angles": np.tile([4.2, 1.4, -1.4, -4.2], rows // 4).tolist(),
        "lidar_origin_to_beam_origin_mm": 15.806,
        "lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1],
        "data_format": {
            "columns_per_frame": 1024,
            "columns_per_packet": 16,
            "column_window": [0, 1023],
            "pixel_shift_by_row": [24, 16, 8, 0] * (rows // 4),
            "pixels_per_column": rows,
            "udp_profile_lidar": profile,
        },
    }


def nested_metadata(flat: dict[str, Any]) -> dict[str, Any]:
    """The same, as the sensor gives it over HTTP."""
    sections = {
        "beam_intrinsics": ("beam_altitude_angles", "beam_azimuth_angles", "lidar_origin_to_beam_origin_mm"),
        "lidar_intrinsics": ("lidar_to_sensor_transform",),
        "config_params": ("lidar_mode",),
        "sensor_info": ("prod_line", "prod_sn"),
    }
    nested = {name: {key: flat[key] for key in keys} for name, keys in sections.items()}
    return {**nested, "lidar_data_format": flat["data_format"]}


def as_json(tree: object) -> bytes:
    """The JSON of a tree."""
    return json.dumps(tree).encode()


def random_packets(layout: OusterLayout, count: int, seed: int = 0) -> npt.NDArray[np.uint8]:
    """Packets whose named bits are random, and plausible in nothing."""
    rng = np.random.default_rng(seed)
    packets = rng.integers(0, 256, (count, layout.packet_bytes), np.uint8)
    return layout.join(layout.split(packets))


def likely_packets(layout: OusterLayout, count: int, seed: int = 0) -> npt.NDArray[np.uint8]:
    """Packets with random pixels, and heads and columns as a sensor sends them."""
    images = layout.split(random_packets(layout, count, seed))
    columns = np.arange(count * layout.columns)
    series = {name: np.zeros_like(numbers) for name, numbers in images.series.items()}
    series["measurement_id"] = columns.astype(np.uint16)
    series["time_ns"] = (500_000_000_000 + 97_656 * columns).astype(np.uint64)
    series["status"] += series["status"].dtype.type(0xFFFF_FFFF if layout.legacy else 1)
    if layout.legacy:
        series["encoder"] = (88 * columns).astype(np.uint32)
    else:
        series["packet_type"] += series["packet_type"].dtype.type(1)
        series["serial"] += series["serial"].dtype.type(122_201_000_998)
    return layout.join(Images(images.planes, series))
