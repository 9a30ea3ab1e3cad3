"""Warnings about a target bitrate that cannot be reached: predicted from the settings, or measured in the stream.

>>> from lidarcodec.settings import StreamSettings
>>> reach_warning(StreamSettings(codec="riddle", target_kbps=1000)) is None
True
>>> warning = reach_warning(StreamSettings(codec="riddle", target_kbps=1000, intensity="lossless", reduction="all"))
>>> warning.code, warning.settings
('target_out_of_reach', ('intensity', 'reduction'))
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple, cast

from lidarcodec.codecs import table
from lidarcodec.codecs.other_sensors import KINDS
from lidarcodec.ratecontrol.choosing import without_auto
from lidarcodec.ratecontrol.control import pins_of
from lidarcodec.ratecontrol.controller import TOLERANCE
from lidarcodec.ratecontrol.curve import RETURNS_A_SECOND, has_curve, operating_curve
from lidarcodec.ratecontrol.image_curve import ImageKind, image_curve
from lidarcodec.settings import AUTO, LATTICE, SettingChanges, StreamSettings

FREE: Final = {"max_error_m": None, "intensity": AUTO, "reduction": AUTO, "purpose": "look"}
"""Settings that can prevent a target, and the value that leaves each of them free."""
SURE: Final = 0.8
"""A target is out of reach if it is below this share of the predicted bitrate; the margin is for different scenes."""
LOWERS: Final = 0.95
"""A setting prevents a target if leaving it free reduces the needed bitrate below this share."""

FEW_COLUMNS: Final = 8
"""If at most one column in so many is sent, a warning names the settings that are the reason."""


class ReachWarning(NamedTuple):
    """Why a target is not reached.

    code:     for programs: `target_out_of_reach` (expected), `target_missed`, `frames_left_out` or `columns_left_out`
              (measured)
    message:  what is wrong;  remedy: what to do;  settings: names of the settings that prevent it
    asked_kbps, sent_kbps, needed_kbps: the target, the mean of five seconds, the bitrate of all frames, or of all
              columns with `columns_left_out`; None: unknown
    """

    code: str
    message: str
    remedy: str
    settings: tuple[str, ...] = ()
    asked_kbps: float | None = None
    sent_kbps: float | None = None
    needed_kbps: float | None = None


def pinned(settings: StreamSettings) -> list[str]:
    """Names of the pinned settings, which a target does not change. Settings of a codec: `codec_settings.NAME`."""
    knob = table.codec(without_auto(settings).codec).knob
    own = [] if knob is None or knob.setting not in settings.codec_settings else [f"codec_settings.{knob.setting}"]
    return [name for name, free in FREE.items() if getattr(settings, name) != free] + own


def least_kbps(settings: StreamSettings, images: ImageKind | None = None) -> float | None:
    """Predicted bitrate of the smallest working point with all frames; None if it was not measured.

    images: of the sensor, if it is not an HDL-64E
    """
    settings = without_auto(settings, None if images is None else KINDS)
    if table.codec(settings.codec).knob is None or not has_curve(settings.codec):
        return None
    if settings.reduces and settings.reduction.partition(":")[0] != LATTICE:
        return None
    if images is not None:
        return float(image_curve(settings.codec, pins_of(settings), images).bits[0]) * images.returns_per_s / 1e3
    curve = operating_curve(settings.codec, pins_of(settings))
    return float(curve.bits[0]) * RETURNS_A_SECOND / 1e3


def in_the_way(settings: StreamSettings, images: ImageKind | None = None) -> tuple[str, ...]:
    """Names of the pinned settings without which frames would be clearly smaller. images: as in `least_kbps`"""
    least = least_kbps(settings, images)
    names = pinned(settings)
    if least is None:
        return tuple(name for name in names if name == "reduction")
    return tuple(name for name in names if (least_kbps(_freed(settings, [name]), images) or least) < LOWERS * least)


def reach_warning(settings: StreamSettings, images: ImageKind | None = None) -> ReachWarning | None:
    """The warning before a target is tried that probably cannot carry all frames; None if it can, or if there is no
    target. images: as in `least_kbps`"""
    least = least_kbps(settings, images)
    if not isinstance(settings.target_kbps, int | float) or least is None or settings.target_kbps >= SURE * least:
        return None
    names = in_the_way(settings, images)
    message = f"{_kbps(settings.target_kbps)} cannot carry every frame: about {least:,.0f} are needed"
    if names:
        message += f" with {_listed(names)} as set"
    return ReachWarning(
        "target_out_of_reach",
        message,
        _remedy(settings, names, least, images),
        names,
        asked_kbps=float(settings.target_kbps),
        needed_kbps=round(least, 1),
    )


def columns_warning(settings: StreamSettings, images: ImageKind | None = None) -> ReachWarning | None:
    """The warning before a target is tried that pinned settings will probably cost most columns; otherwise None.

    images: as in `least_kbps`
    """
    least = least_kbps(settings, images)
    if not isinstance(settings.target_kbps, int | float) or least is None or settings.target_kbps < least:
        return None
    target = float(settings.target_kbps)
    rate = {"step": _step_at(settings, target, images), "target_kbps": target, "reachable_kbps": [least, least]}
    return _few_columns(settings, rate, images)


def missed_warning(
    settings: StreamSettings, rate: Mapping[str, Any] | None, images: ImageKind | None = None
) -> ReachWarning | None:
    """The warning for a stream that misses its target, or reaches it only by skipping frames or, because of pinned
    settings, most columns; otherwise None.

    rate: the field `rate` of a status with these settings; its fields may be missing. None: no status yet
    images: as in `least_kbps`
    """
    if settings.target_kbps is None or table.codec(without_auto(settings).codec).knob is None:
        return None
    ends = (rate or {}).get("reachable_kbps")
    if not rate or not ends:
        return reach_warning(settings, images)
    asked, sent, needed = rate.get("target_kbps"), rate.get("kbps_5s"), float(ends[0])
    if not asked:
        return None
    path = " that the path carries" if settings.target_kbps == AUTO else ""
    names = in_the_way(settings, images)
    because = f" with {_listed(names)} as set" if names else ""
    if not path and sent is not None and sent > asked * (1.0 + TOLERANCE):
        code = "target_missed"
        message = f"{_kbps(asked)} are asked for, {sent:,.0f} are sent; every frame takes {needed:,.0f}{because}"
    elif rate.get("limited_by") == "floor":
        code = "frames_left_out"
        message = f"the {_kbps(asked)}{path} do not carry every frame: {needed:,.0f} are needed{because}"
    else:
        return _few_columns(settings, rate, images)
    return ReachWarning(code, message, _remedy(settings, names, needed, images), names, asked, sent, needed)


def _few_columns(settings: StreamSettings, rate: Mapping[str, Any], images: ImageKind | None) -> ReachWarning | None:
    """The warning that few columns are sent, if twice as many would be without some pinned setting."""
    step, asked, least = rate.get("step"), rate["target_kbps"], least_kbps(settings, images)
    if not isinstance(step, int) or step < FEW_COLUMNS or settings.reduction != AUTO or not least:
        return None
    scene = rate["reachable_kbps"][0] / least
    pins = [name for name in pinned(settings) if name != "purpose"]

    def then(names: list[str]) -> int:
        return _step_at(_freed(settings, names), asked / scene, images)

    names = [name for name in pins if 2 * then([name]) <= step]
    names = names or (pins if pins and 2 * then(pins) <= step else [])
    if not names:
        return None
    of = _listed(tuple(names))
    path = " that the path carries" if settings.target_kbps == AUTO else ""
    message = f"the {_kbps(asked)}{path} carry only every {_ordinal(step)} column with {of} as set"
    every = then(names)
    remedy = f"set {of} back, then " + ("all columns are" if every == 1 else f"about every {_ordinal(every)} column is")
    all_of = (least_kbps(settings.changed(reduction="all"), images) or 0.0) * scene
    needed = round(all_of, 1) or None
    instead = ", or use a better path" if path else f", or set a higher target: all columns take {all_of:,.0f} kbit/s"
    return ReachWarning(
        "columns_left_out", message, f"{remedy} sent{instead}", tuple(names), asked, rate.get("kbps_5s"), needed
    )


def _step_at(settings: StreamSettings, kbps: float, images: ImageKind | None) -> int:
    """The predicted step of the lattice at a bitrate."""
    settings = without_auto(settings, None if images is None else KINDS)
    pins = pins_of(settings)
    curve = operating_curve(settings.codec, pins) if images is None else image_curve(settings.codec, pins, images)
    per_s = RETURNS_A_SECOND if images is None else images.returns_per_s
    within = int((curve.bits * per_s / 1e3 <= kbps).sum())
    return curve.points[max(within - 1, 0)].step


def _ordinal(number: int) -> str:
    """
    >>> _ordinal(2), _ordinal(12), _ordinal(23)
    ('2nd', '12th', '23rd')
    """
    teens = 10 < number % 100 < 20
    return f"{number}{'th' if teens else {1: 'st', 2: 'nd', 3: 'rd'}.get(number % 10, 'th')}"


def _freed(settings: StreamSettings, names: list[str]) -> StreamSettings:
    """The settings with some of the pinned ones left free."""
    own = {name: value for name, value in settings.codec_settings.items() if f"codec_settings.{name}" not in names}
    free = {name: FREE[name] for name in names if name in FREE} | {"codec_settings": own}
    return settings.changed(**cast(SettingChanges, free))


def _remedy(settings: StreamSettings, names: tuple[str, ...], needed: float, images: ImageKind | None) -> str:
    """What to do if all frames need `needed` kbit/s."""
    instead = (
        "choose another codec, or use a better path"
        if settings.target_kbps == AUTO
        else f"set a target of {needed:,.0f} kbit/s or more"
    )
    if not names:
        return instead if settings.target_kbps == AUTO else f"{instead}, or choose another codec"
    least, free = least_kbps(settings, images), least_kbps(_freed(settings, list(names)), images)
    takes = f", which needs about {needed * free / least:,.0f} kbit/s" if least and free else ""
    return f"set {_listed(names)} back{takes}, or {instead}"


def _listed(names: tuple[str, ...]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _kbps(value: float) -> str:
    return f"{value:,.0f} kbit/s"
