"""Times as people and programs write them: RFC 3339, or ns since the Unix epoch.

>>> time_ns_of("2026-11-26T12:00:00.5Z"), time_ns_of("1795694400500000000"), time_ns_of(7)
(1795694400500000000, 1795694400500000000, 7)
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Final

from lidarcodec.errors import SettingsError

_RFC_3339: Final = re.compile(r"(\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d)(?:\.(\d{1,9})\d*)?([Zz]|[+-]\d\d:\d\d)", re.ASCII)
_NS: Final = re.compile(r"\d{1,19}", re.ASCII)
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def time_ns_of(value: object, field: str = "time") -> int:
    """A time in ns since the Unix epoch.

    Raises SettingsError, with `field`, for anything else than RFC 3339 with a time zone, and ns since the epoch.
    """
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63:
        return value
    text = value.strip() if isinstance(value, str) else ""
    if _NS.fullmatch(text) and int(text) < 2**63:
        return int(text)
    found = _RFC_3339.fullmatch(text)
    try:
        if found is not None:
            whole, fraction, zone = found.groups()
            moment = datetime.fromisoformat(whole.upper().replace(" ", "T") + zone.upper().replace("Z", "+00:00"))
            since = moment - _EPOCH
            stamp_ns = (since.days * 86400 + since.seconds) * 10**9 + int((fraction or "").ljust(9, "0"))
            if 0 <= stamp_ns < 2**63:
                return stamp_ns
    except (ValueError, OverflowError):
        pass
    raise SettingsError(
        f"{field} must be a time such as 2026-11-26T12:00:00Z, or nanoseconds since 1970, not '{text[:40]}'", field
    )


def rfc_3339(stamp_ns: int) -> str:
    """A time as text, in UTC, to the millisecond below; in ns if no calendar has it.

    >>> rfc_3339(1795694400500000000), rfc_3339(10**24)
    ('2026-11-26T12:00:00.500Z', '1000000000000000000000000 ns since 1970')
    """
    try:
        whole = datetime.fromtimestamp(stamp_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return f"{stamp_ns} ns since 1970"
    return f"{whole}.{stamp_ns % 10**9 // 10**6:03d}Z"
