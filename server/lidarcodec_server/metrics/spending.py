"""Gauges for Prometheus about the bits of a stream: target, what its path carries, error bound, share of returns,
intensity levels.

A gauge has no sample if the stream does not report the value or its codec does not have it.

>>> gauges_of({"rate": {"target_kbps": 800.0, "reached": False, "limited_by": "floor"}}, None)
{'target_kbps': 800.0, 'target_missed': 1.0}
"""

from __future__ import annotations

from typing import Any, Final

from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.settings import AUTO, StreamSettings, settings_from
from lidarcodec_server.fleet.fleet import number_in

SPENDING: Final = {
    "target_kbps": "Target bitrate in force. With `auto`: what the path carries, less a reserve.",
    "target_missed": "1 while the target bitrate is missed. 0 if everything is sent exactly with fewer bits.",
    "bound_meters": "Largest error of a range, in force; 0 is exact. For codecs with an error bound.",
    "kept_ratio": "Share of the measured returns that is sent, in frames that are sent.",
    "path_kbps": "What the path carries, as single messages show it.",
    "path_sustained_kbps": "What the path carries for long. No sample until it is seen to let bursts through.",
    "intensity_levels": "Number of intensity values that are sent: 256 is exact, 0 is none.",
}
"""Metric, without `lidarcodec_stream_`: help."""


def gauges_of(status: dict[str, Any], settings: StreamSettings | None, codec: str | None = None) -> dict[str, float]:
    """The gauges from a stream's last status. codec: the codec in force"""
    rate, path = status.get("rate"), status.get("path")
    found = {
        "target_kbps": number_in(rate, "target_kbps"),
        "target_missed": _missed(rate),
        "bound_meters": _bound(rate, settings, codec),
        "path_kbps": number_in(path, "capacity_kbps"),
        "path_sustained_kbps": number_in(path, "sustained_kbps"),
        "kept_ratio": _kept(rate, status.get("reduction")),
        "intensity_levels": _levels(rate, settings),
    }
    return {name: value for name, value in found.items() if value is not None}


def _missed(rate: Any) -> float | None:
    if not isinstance(rate, dict) or not isinstance(rate.get("reached"), bool):
        return None
    return float(not rate["reached"] and rate.get("limited_by") != "codec")


def _bound(rate: Any, settings: StreamSettings | None, codec: str | None) -> float | None:
    turned = number_in(rate, "max_error_m")
    if turned is not None or rate is not None or settings is None or codec is None:
        return turned
    try:
        bounded = table.codec(codec).bounded
    except UnknownNameError:
        return None
    return (settings.base.max_error_m or 0.0) if bounded else None


def _kept(rate: Any, reduction: Any) -> float | None:
    returns, kept = number_in(reduction, "returns"), number_in(reduction, "kept")
    if reduction is not None:
        return None if returns is None or kept is None or returns <= 0 else kept / returns
    step = 1.0 if rate is None else number_in(rate, "step")
    return None if step is None or step < 1.0 else 1.0 / step


def _levels(rate: Any, settings: StreamSettings | None) -> float | None:
    text = rate.get("intensity") if isinstance(rate, dict) else None
    if text is None and settings is not None and (rate is None or settings.intensity != AUTO):
        return float(settings.intensity_levels)
    try:
        return float(settings_from({"intensity": text}).intensity_levels)
    except SettingsError:
        return None
