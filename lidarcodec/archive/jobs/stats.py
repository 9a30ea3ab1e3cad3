"""The job `stats`: what an archive holds, by vehicle, sensor and codec. It reads the tables alone."""

from __future__ import annotations

from typing import Any, Final

from lidarcodec.archive.query import query
from lidarcodec.archive.stores.base import Store

_SQL: Final = """
    select vehicle, sensor, codec, count(distinct segment) as segments, count(*) as frames,
           cast(min(stamp_ns) as bigint) as first_ns, cast(max(stamp_ns) as bigint) as last_ns,
           cast(sum(points) as bigint) as points, cast(sum(packet_bytes) as bigint) as packet_bytes,
           cast(sum(bytes) as bigint) as bytes,
           case when count(bound_m) = count(*) then max(bound_m) end as bound_m,
           case when count(error_m) = count(*) then max(error_m) end as error_m
    from frames group by vehicle, sensor, codec order by vehicle, sensor, codec
"""


def stats(value: dict[str, Any], source: Store, target: Store) -> dict[str, Any]:
    """Returns `stats`, a row for each vehicle, sensor and codec, and `lost`, the number of segments without a table.

    Raises OSError, SourceError.
    """
    del value, source
    names, rows, lost = query(target, _SQL)
    return {"stats": [dict(zip(names, row, strict=True)) for row in rows], "lost": lost}
