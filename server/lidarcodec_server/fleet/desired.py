"""The settings that operators want for a stream, with the codec that they belong to.

A setting that no operator set keeps the value of the vehicle's command line.

>>> base = StreamSettings(codec="pcodec", key_interval=20)
>>> want = wanted_with({}, {"max_error_m": 0.01}, base)
>>> want
{'max_error_m': 0.01, 'codec': 'pcodec'}
>>> in_step(want, base), in_step(want, base.changed(max_error_m=0.01))
(False, True)
"""

from __future__ import annotations

from typing import Any

from lidarcodec.apps.control import settings_with
from lidarcodec.settings import StreamSettings


def wanted_with(before: dict[str, Any], changes: dict[str, Any], base: StreamSettings | None) -> dict[str, Any]:
    """The wanted settings after a change, in the form in which they are stored and sent.

    base: the settings in force, None if they are unknown

    Raises SettingsError or UnknownNameError if all of them together are not allowed.
    """
    known = base or StreamSettings()
    wanted = dict(before)
    if changes.get("codec", before.get("codec", known.codec)) != before.get("codec", known.codec):
        wanted.pop("codec_settings", None)
    wanted |= changes
    if base is not None and wanted:
        wanted.setdefault("codec", base.codec)
    values = settings_with(known, wanted).model_dump()
    return {field: values[field] for field in wanted}


def overlaid(wanted: dict[str, Any], base: StreamSettings | None) -> dict[str, Any] | None:
    """All settings of a stream once it has the wanted ones; None if nothing is wanted."""
    if not wanted:
        return None
    values = (base or StreamSettings()).model_dump()
    if wanted.get("codec", values["codec"]) != values["codec"]:
        values["codec_settings"] = {}
    return values | wanted


def in_step(wanted: dict[str, Any], applied: StreamSettings) -> bool:
    """Whether the settings in force include the wanted ones."""
    values = applied.model_dump()
    return all(values.get(field) == value for field, value in wanted.items())
