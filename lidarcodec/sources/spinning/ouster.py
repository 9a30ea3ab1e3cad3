"""Simulated units of Ouster's sensors, and their metadata.

Beams are spread evenly from top to bottom, four of them side by side, as the metadata of real units says; a unit with
fewer than 128 beams has every second or every fourth of them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.images import Images, Metres, Unsigned
from lidarcodec.sensors.models.ouster.layouts import OusterLayout
from lidarcodec.sensors.models.ouster.metadata import BEAM_ORIGIN_MM
from lidarcodec.sensors.models.ouster.sensor import OusterSensor, model_from, sensor_from
from lidarcodec.sources.spinning.base import Heads
from lidarcodec.sources.spinning.encoder import TURN_NS, Numbers, jitter_ns

LEAD_NS: Final = 1_000_000
MODES: Final = ("512x10", "1024x10", "2048x10")
SERIAL: Final = 990_000_000_001
"""No unit has it: there is no week 00 of year 99."""
ENCODER_TURN: Final = 90_112
ALL_BEAMS: Final = 128
JITTER_NS: Final = 4_000
SWING_NS, SWING_COLUMNS = 20_000, 30_000
"""How far the times of columns swing around even ones, and after how many columns they do so again."""
VALID: Final = {True: 0xFFFF_FFFF, False: 1}
"""Status of a column that was measured, by whether the profile is LEGACY."""


class Optics(NamedTuple):
    """Of a family: elevation of the top and the bottom beam, the largest azimuth offset, and the height of the beams'
    origin above the sensor's base."""

    top_deg: float
    bottom_deg: float
    aside_deg: float
    height_mm: float


OPTICS: Final = {
    "0": Optics(45.4, -45.4, 10.6, 36.18),
    "1": Optics(21.0, -21.8, 4.2, 36.18),
    "2": Optics(10.8, -11.1, 2.1, 78.296),
}
"""As in the metadata of units that ouster-sdk's tests have (46b7bcee, BSD-3-Clause)."""


def metadata_of(family: str, rows: int, profile: str, mode: str) -> bytes:
    """The metadata JSON of a simulated unit. family: `0`, `1` or `2`; mode: one of MODES."""
    optics, columns = OPTICS[family], int(mode.partition("x")[0])
    beams = np.arange(rows) * (ALL_BEAMS // rows) + ALL_BEAMS // rows // 2
    altitudes = optics.top_deg + (optics.bottom_deg - optics.top_deg) * beams / (ALL_BEAMS - 1)
    azimuths = optics.aside_deg * np.array([1, 1 / 3, -1 / 3, -1])[beams % 4]
    product = f"OS-{family}-{rows}"
    data: dict[str, Any] = {
        "prod_line": product,
        "prod_pn": "",
        "prod_sn": str(SERIAL),
        "image_rev": "simulated",
        "build_rev": "v3.0.0",
        "status": "RUNNING",
        "initialization_id": 1,
        "lidar_mode": mode,
        "beam_altitude_angles": np.round(altitudes, 2).tolist(),
        "beam_azimuth_angles": np.round(azimuths, 2).tolist(),
        "lidar_origin_to_beam_origin_mm": BEAM_ORIGIN_MM[family],
        "lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, optics.height_mm, 0, 0, 0, 1],
        "imu_to_sensor_transform": [1, 0, 0, 6.253, 0, 1, 0, -11.775, 0, 0, 1, 7.645, 0, 0, 0, 1],
        "data_format": {
            "columns_per_frame": columns,
            "columns_per_packet": 16,
            "column_window": [0, columns - 1],
            "pixels_per_column": rows,
            "pixel_shift_by_row": np.rint(azimuths * columns / 360).astype(int).tolist(),
            "udp_profile_lidar": profile,
            "udp_profile_imu": "LEGACY",
        },
    }
    return (json.dumps(data, indent=1) + "\n").encode()


@dataclass(frozen=True, eq=False)
class OusterUnit:
    """A simulated Ouster. metadata: its JSON; start_ns: of the drive, ns since the Unix epoch."""

    metadata: bytes
    start_ns: int

    @cached_property
    def sensor(self) -> OusterSensor:
        """Its model."""
        return sensor_from(self.metadata)

    @property
    def layout(self) -> OusterLayout:
        """Of its packets."""
        return self.sensor.layout

    @cached_property
    def model(self) -> SensorModel:
        """The unit, with the beams of its metadata."""
        return model_from(self.metadata, "simulated")

    @property
    def turn_packets(self) -> int:
        """Packets of a turn."""
        return self.layout.turn_columns // self.layout.columns

    def heads(self, first: int, count: int) -> Heads:
        """Of the packets number `first`, which may be -1, and the `count - 1` after it."""
        layout = self.layout
        columns = np.arange(first * layout.columns, (first + count) * layout.columns, dtype=np.int64)
        times = self._column_ns(columns)
        ids, turns = columns % layout.turn_columns, columns // layout.turn_columns
        packets = turns[:: layout.columns]
        known: dict[str, Numbers] = {
            "time_ns": self.start_ns + times,
            "measurement_id": ids,
            "status": np.full(len(columns), VALID[layout.legacy]),
            "encoder": ids * (ENCODER_TURN // layout.turn_columns),
            "packet_type": np.ones(count, np.int64),
            "init_id": np.ones(count, np.int64),
            "serial": np.full(count, SERIAL),
            "frame_id": (turns if layout.legacy else packets) % (1 << (32 if layout.fusa_head else 16)),
        }
        series: dict[str, Unsigned] = {}
        for name, (dtype, each) in layout.series.items():
            series[name] = known.get(name, np.zeros(count * each, np.int64)).astype(dtype)
        return Heads(series, times[:: layout.columns])

    def origins(self, images: Images) -> tuple[Metres, Metres, Metres]:
        """Where beams begin: the points of ranges 0."""
        return self.sensor.points(self.model, self.layout, images)

    def silence(self, images: Images) -> None:
        """All channels fire."""

    def _column_ns(self, columns: Numbers) -> Numbers:
        """Times of columns since the start of the drive: columns are fired at even steps of the encoder."""
        even = LEAD_NS + columns * TURN_NS // self.layout.turn_columns
        swing = SWING_NS * np.sin(columns * (2 * np.pi / SWING_COLUMNS))
        times: Numbers = even + np.rint(swing).astype(np.int64) + jitter_ns(columns, JITTER_NS)
        return times
