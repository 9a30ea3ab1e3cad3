"""The rows of settings that operators want: read and written within a transaction, also beside other servers."""

from __future__ import annotations

import time
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection
from sqlalchemy.exc import IntegrityError

from lidarcodec.errors import LidarCodecError, SettingsError
from lidarcodec.settings import settings_from
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.limits import SparseLog
from lidarcodec_server.store.tables import desired
from lidarcodec_server.told import check_settings_size


class ChangedError(LidarCodecError):
    """Another server with the same database has changed these settings."""


def read(connection: Connection, keys: StreamKeys, warnings: SparseLog, *, to_change: bool = False) -> dict[str, Any]:
    """The settings of a stream; empty if there are none, or none that can be used.

    to_change: until the end of the transaction no other server changes them
    """
    query = sa.select(desired.c.settings).where(*_of(keys))
    found = connection.execute(query.with_for_update() if to_change else query).scalar_one_or_none()
    try:
        kept = {} if found is None else dict(found)
        check_settings_size(kept)
        settings_from(kept)
    except (SettingsError, TypeError, ValueError) as error:
        warnings.warning("%s: cannot use the settings in the database: %s", keys.prefix, error)
        return {}
    return kept


def keep(connection: Connection, keys: StreamKeys, wanted: dict[str, Any], max_streams: int) -> None:
    """Store the settings of a stream; empty ones are deleted.

    Raises ChangedError if another server was quicker to store the first, SettingsError if the limit of streams is
    reached.
    """
    if not wanted:
        connection.execute(sa.delete(desired).where(*_of(keys)))
        return
    values = {"settings": wanted, "updated_ns": time.time_ns()}
    if connection.execute(sa.update(desired).where(*_of(keys)).values(values)).rowcount:
        return
    count = connection.execute(sa.select(sa.func.count()).select_from(desired)).scalar_one()
    if count >= max_streams:
        raise SettingsError(
            f"settings of {count} streams are stored, which is the limit: delete some first (DELETE .../settings)"
        )
    try:
        with connection.begin_nested():
            connection.execute(sa.insert(desired).values(vehicle=keys.vehicle, sensor=keys.sensor, **values))
    except IntegrityError:
        raise ChangedError("another server has stored settings of this stream") from None


def undone(kept: dict[str, Any], wanted: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """The settings after a change was taken back. What another server has changed meanwhile stays.

    kept: the settings now;  wanted, before: those with the change, and without it

    >>> undone({"codec": "jxl"}, {"codec": "jxl"}, {"codec": "raw", "codec_settings": {}})
    {'codec': 'raw', 'codec_settings': {}}
    >>> undone({"codec": "jxl", "key_interval": 9}, {"codec": "jxl"}, {})
    {'key_interval': 9}
    """
    if kept == wanted:
        return before
    found = {name: before.get(name) if wanted.get(name) == value else value for name, value in kept.items()}
    return {name: value for name, value in found.items() if name in before or wanted.get(name) != kept[name]}


def _of(keys: StreamKeys) -> tuple[sa.ColumnElement[bool], sa.ColumnElement[bool]]:
    return desired.c.vehicle == keys.vehicle, desired.c.sensor == keys.sensor
