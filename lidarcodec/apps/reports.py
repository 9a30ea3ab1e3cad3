"""Messages of a receiver: an arrival report for each received message, and a report once a second.

An arrival report is 36 bytes, little endian: index of the message's first frame (u64), the receiver's host time in ns
since the Unix epoch (i64), ns for which it held the report because its decoder was busy (u64), the message's checksum
(u32), which proves that it was received, and which of the 64 indices before it arrived (u64, bit k: index - 1 - k). So
a report says at once what is missing, and makes good for reports that were lost. Further bytes are ignored. A report is
a JSON object; unknown fields are dropped.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

from lidarcodec.apps.timings import BOUNDS_MS
from lidarcodec.untrusted.json import JsonRefusedError, read_object

_ARRIVAL = struct.Struct("<QqQIQ")
_REFINED = struct.Struct("<QIB")
EARLIER = 64
"""Number of earlier indices in an arrival report."""
MAX_REPORT_BYTES = 4096
COUNTED = (
    "frames",
    "messages",
    "bytes",
    "gaps",
    "missing",
    "jumps",
    "restarts",
    "stale",
    "clocks_apart",
    "decode_errors",
    "missing_references",
)
"""Fields with counts since the receiver's start."""
MEASURED = (
    "fps",
    "latency_p50_ms",
    "latency_p99_ms",
    "decode_p50_ms",
    "decode_p99_ms",
    "rtt_ms",
    "clock_offset_ms",
    "clock_bound_ms",
)
"""Fields with measurements over the newest values; null if unknown."""
START = "start"
"""A random number of the receiver, because two servers report under one name."""
SUMMED = ("latency_sum_ms", "decode_sum_ms")
COUNTED_TIMES = ("latency_buckets", "decode_buckets")
"""Fields with histograms since the receiver's start: a count for each bound in `timings.BOUNDS_MS`, and for longer
times."""


STATUS_FIELDS = frozenset(
    (
        "vehicle",
        "sensor",
        "stream_id",
        "stamp_ns",
        "settings",
        "codec",
        "codec_choice",
        "sensor_model",
        "matching",
        "ended",
        "mount",
        "time_source",
        "packets",
        "assembled",
        "replaced",
        "no_receiver",
        "left_out",
        "frames",
        "messages",
        "bytes",
        "key_frames",
        "frame_index",
        "fps",
        "mean_fps",
        "kbps",
        "rate",
        "images",
        "reduction",
        "learning",
        "path",
        "encode_ms",
        "put_ms",
        "flight",
        "errors",
        "preparing",
        "worker",
        "worker_restarts",
        "source",
        "recording",
        "past",
        "certificate",
        "gate",
        "reports",
        "refinements",
    )
)
"""Fields of a publisher's status that receivers use."""


Report = dict[str, int | float | list[int] | None]
"""The known fields of a receiver's report."""


class Arrival(NamedTuple):
    """frame_index: index of the message's first frame; now_ns: the receiver's host time; held_ns: delay of the report;
    checksum: checksum of the message; earlier: bit k is set if a message of index `frame_index - 1 - k` had arrived"""

    frame_index: int
    now_ns: int
    held_ns: int
    checksum: int
    earlier: int = 0

    def has(self, index: int) -> bool:
        """Whether a message of that earlier index had arrived."""
        back = self.frame_index - 1 - index
        return 0 <= back < EARLIER and bool(self.earlier >> back & 1)


def pack_arrival(arrival: Arrival) -> bytes:
    """Bytes of an arrival report."""
    return _ARRIVAL.pack(*arrival)


def read_arrival(data: bytes) -> Arrival | None:
    """An arrival report; None if the bytes are not one."""
    return Arrival(*_ARRIVAL.unpack_from(data)) if len(data) >= _ARRIVAL.size else None


class Refined(NamedTuple):
    """Arrival report of a refinement. checksum: of its message"""

    frame_index: int
    checksum: int
    sector: int


def pack_refined(report: Refined) -> bytes:
    """Bytes of an arrival report of a refinement: 13 bytes, little endian (u64, u32, u8)."""
    return _REFINED.pack(*report)


def read_refined(data: bytes) -> Refined | None:
    """An arrival report of a refinement; None if the bytes are not one."""
    return Refined(*_REFINED.unpack_from(data)) if len(data) >= _REFINED.size else None


def read_status(data: bytes) -> dict[str, Any]:
    """The known fields of a publisher's status.

    Raises JsonRefusedError.
    """
    return {name: value for name, value in read_object(data).items() if name in STATUS_FIELDS}


def read_report(data: bytes) -> Report | None:
    """The known fields of a report; None if the bytes are not one."""
    try:
        values = read_object(data, MAX_REPORT_BYTES)
    except JsonRefusedError:
        return None
    report: Report = {}
    for name in (START, *COUNTED, *MEASURED, *SUMMED):
        value = values.get(name)
        if value is None and name in MEASURED:
            report[name] = None
        elif isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 2**63:
            report[name] = value
    for name in COUNTED_TIMES:
        value = values.get(name)
        if isinstance(value, list) and len(value) == len(BOUNDS_MS) + 1 and all(_is_count(count) for count in value):
            report[name] = value
    return report


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63
