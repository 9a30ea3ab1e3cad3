"""Whose time a sensor has: an operator who compares two vehicles must know whether one of them lost GPS."""

from __future__ import annotations

import pytest

from lidarcodec.packet import Packet
from lidarcodec.sensors.sensor_time import SensorTime

HOUR_NS = 3_600_000_000_000


def packet(stamp_ns: int, gps_us: int, status: bytes) -> Packet:
    return Packet(bytes(1200) + gps_us.to_bytes(4, "little") + status, stamp_ns)


@pytest.mark.parametrize(
    ("code", "said"), [(b"A", "GPS and pulse"), (b"V", "GPS"), (b"P", "pulse"), (b"\0", "none"), (b"x", "unknown")]
)
def test_the_sensor_says_where_it_has_its_time_from(code, said):
    time = SensorTime()
    assert time.report(live=True) == {"sensor": None, "host_minus_sensor_ms": None}
    time.push(packet(0, 0, b"H\x07"))
    assert time.report(live=True)["sensor"] is None
    time.push(packet(HOUR_NS + 5_000_000, 2_000, b"G" + code))
    report = time.report(live=True)
    assert report["sensor"] == said
    assert report["host_minus_sensor_ms"] == (3.0 if code in (b"A", b"V") else None)
    assert time.report(live=False)["host_minus_sensor_ms"] is None


def test_the_hour_wraps_and_a_short_packet_is_nothing():
    time = SensorTime()
    time.push(packet(HOUR_NS, 3_599_990_000, b"GA"))
    assert time.report(live=True)["host_minus_sensor_ms"] == 10.0
    time.push(Packet(b"", 0))
    time.push(Packet(bytes(512), 0))
    assert time.report(live=True)["sensor"] == "GPS and pulse"
