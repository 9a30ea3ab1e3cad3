"""Whether a target bitrate can be kept with what is pinned, as far as can be said before a frame was encoded.

>>> from lidarcodec.settings import StreamSettings
>>> reach_warning(StreamSettings(codec="riddle", target_kbps=1000)) is None
True
>>> reach_warning(StreamSettings(codec="riddle", target_kbps=1000, intensity="lossless", reduction="all")).code
'target_out_of_reach'
"""

from __future__ import annotations

from typing import Final, NamedTuple

from lidarcodec.codecs import table
from lidarcodec.ratecontrol.choosing import without_auto
from lidarcodec.ratecontrol.control import pins_of
from lidarcodec.ratecontrol.curve import RETURNS_A_SECOND, Pins, operating_curve
from lidarcodec.settings import AUTO, StreamSettings

FREE: Final = {"max_error_m": None, "intensity": AUTO, "reduction": AUTO, "purpose": "look"}
"""Settings that keep a stream from its target, and what leaves them free."""
SURE: Final = 0.8
"""A target is said to be out of reach below this share of what is expected to be needed: scenes differ."""


class ReachWarning(NamedTuple):
    """code: for programs;  message: what is wrong;  remedy: what to do"""

    code: str
    message: str
    remedy: str


def pinned(settings: StreamSettings) -> list[str]:
    """Names of the settings that are set and keep a stream from its target."""
    return [name for name, free in FREE.items() if getattr(settings, name) != free]


def least_kbps(settings: StreamSettings) -> float:
    """What the smallest working point is expected to take, all frames sent."""
    settings = without_auto(settings)
    curve = operating_curve(settings.codec, pins_of(settings))
    return float(curve.bits[0]) * RETURNS_A_SECOND / 1e3


def reach_warning(settings: StreamSettings) -> ReachWarning | None:
    """What to tell who sets a target that cannot be kept with all frames; None if it can, or there is none."""
    settings = without_auto(settings)
    if not isinstance(settings.target_kbps, int | float) or table.codec(settings.codec).knob is None:
        return None
    least = least_kbps(settings)
    if settings.target_kbps >= SURE * least:
        return None
    names = pinned(settings)
    free = float(operating_curve(settings.codec, Pins()).bits[0]) * RETURNS_A_SECOND / 1e3
    message = f"{settings.target_kbps:g} kbit/s cannot carry every frame: about {least:.0f} are needed"
    if names and free < least:
        return ReachWarning(
            "target_out_of_reach",
            f"{message} with {', '.join(names)} as set",
            f"set {' and '.join(names)} back, which needs about {free:.0f} kbit/s, or a target of {least:.0f}",
        )
    return ReachWarning("target_out_of_reach", message, f"set a target of {least:.0f} kbit/s or more, or another codec")
