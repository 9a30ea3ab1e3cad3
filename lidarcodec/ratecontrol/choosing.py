"""The choice for `codec=auto`: the codec with the best quality at the target, of those that encode fast enough.

Operating curves give the quality of a codec at a target. The caller measures encoding times on this machine. Pure.

>>> wanted = StreamSettings(codec="auto", target_kbps=1000)
>>> ranked(wanted)[:3]
('riddle', 'predictive', 'pcodec')
>>> choice(wanted, {"riddle": 61.0, "predictive": 12.0}, budget_ms=50.0).codec
'predictive'
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final, NamedTuple

import numpy as np

from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError
from lidarcodec.ratecontrol.adaptive import START_KBPS
from lidarcodec.ratecontrol.control import pins_of
from lidarcodec.ratecontrol.curve import RETURNS_A_SECOND, has_curve, operating_curve
from lidarcodec.reduction.table import check as check_reduction
from lidarcodec.settings import AUTO, StreamSettings

SHARE: Final = 0.3
"""Share of the time between two frames that encoding may take. Decoding takes about as long, and the rest is for the
path: a frame should arrive before the next one is measured."""
KEEPS_UP: Final = 0.6
"""Share that is allowed where no codec keeps within SHARE: frames arrive later, but the encoder keeps up."""
BETTER: Final = 0.8
"""Where a codec is in force already, another one replaces it only if it takes this share of what it may take."""


class Choice(NamedTuple):
    """codec: its name;  because: the reason;  encode_ms: mean time of a frame for each codec that was tried
    budget_ms: longest allowed time, None while unknown
    """

    codec: str
    because: str
    encode_ms: dict[str, float]
    budget_ms: float | None


def ranked(settings: StreamSettings) -> tuple[str, ...]:
    """Names of the codecs from which `auto` chooses, best quality at the target first; without a target fewest bits
    first.

    Only codecs that are installed, have an error bound, support rate control, were measured, and need no process of
    their own. All others have a lower quality at every target and take longer, or their quality is unknown.
    Raises SettingsError for a reduction that is not allowed.
    """
    check_reduction(settings)
    able = [
        name
        for name in table.installed()
        if (codec := table.codec(name)).knob and codec.bounded and not codec.isolated and has_curve(name)
    ]
    return tuple(sorted(able, key=lambda name: _shortcoming(with_codec(settings, name))))


def with_codec(settings: StreamSettings, name: str) -> StreamSettings:
    """The settings with that codec in place of `auto`.

    Raises SettingsError if they have settings of a codec, because the codec is not known yet.
    """
    if settings.codec_settings:
        given = ", ".join(settings.codec_settings)
        raise SettingsError(
            f"codec auto has no settings of its own: leave out {given}, or name a codec", "codec_settings"
        )
    return settings.model_copy(update={"codec": name})


def without_auto(settings: StreamSettings, among: Collection[str] | None = None) -> StreamSettings:
    """The settings themselves, or with the first of `ranked` in place of `auto`: the choice if time does not matter.

    among: names of the codecs that take the sensor's frames; all by default
    Raises the errors of `with_codec`.
    """
    if settings.codec != AUTO:
        return settings
    return with_codec(settings, next(name for name in ranked(settings) if among is None or name in among))


def within(name: str, took_ms: float, budget_ms: float, kept: str | None = None) -> bool:
    """Whether a codec is quick enough. kept: the codec in force; another one then needs a margin, so that two that are
    about as quick do not replace each other again and again"""
    return took_ms <= (budget_ms if kept in (None, name) else BETTER * budget_ms)


def choice(
    settings: StreamSettings, encode_ms: Mapping[str, float], budget_ms: float, kept: str | None = None
) -> Choice:
    """The first of `ranked` that is `within` the budget, of those that were tried; where none is, the first that keeps
    up; otherwise the fastest.

    encode_ms: milliseconds for a frame, for each codec that was tried; at least one
    kept: the codec in force, if this is not the first choice
    """
    times = {name: round(took, 1) for name, took in encode_ms.items()}
    tried = [name for name in ranked(settings) if name in encode_ms]
    told = [f"{name} ({times[name]:g} ms)" for name in tried]
    for margin in (kept, None):  # where even the one in force is too slow, another one needs no margin
        for place, name in enumerate(tried):
            if within(name, encode_ms[name], budget_ms, margin):
                most = "gives the best picture" if settings.target_kbps is not None else "takes the fewest bits"
                of = f" of those that encode a frame within {budget_ms:.0f} ms here"
                slow = [told[at] for at in range(place) if encode_ms[tried[at]] > budget_ms]
                near = [told[at] for at in range(place) if encode_ms[tried[at]] <= budget_ms]
                other = f"; too slow: {', '.join(slow)}" * bool(slow)
                other += f"; too close to that to change to: {', '.join(near)}" * bool(near)
                return Choice(name, f"{most}{of} ({times[name]:g} ms){other}", times, budget_ms)
    none = (
        f"no codec encodes a frame within {budget_ms:.0f} ms here; tried: {', '.join(told)}; they are tried again later"
    )
    most_ms = budget_ms * KEEPS_UP / SHARE
    for margin in (kept, None):
        for name in tried:
            if within(name, encode_ms[name], most_ms, margin):
                return Choice(name, f"the best that keeps up, but frames arrive later: {none}", times, budget_ms)
    quickest = min(encode_ms, key=lambda name: encode_ms[name] * (BETTER if name == kept else 1.0))
    return Choice(quickest, f"the fastest, and too slow: {none}", times, budget_ms)


def _shortcoming(settings: StreamSettings) -> tuple[float, float]:
    """The cost of the image at the target in metres, and the bits a return at the finest point."""
    target = settings.target_kbps
    pins = pins_of(settings)
    if target is None:
        pins = pins._replace(step=pins.step or 1, levels=settings.intensity_levels)
    curve = operating_curve(settings.codec, pins)
    finest = float(curve.bits[-1])
    if target is None:
        return 0.0, finest if settings.max_error_m is None else float(curve.bits[0])
    kbps = curve.bits * RETURNS_A_SECOND / 1e3
    wanted = START_KBPS if target == AUTO else target
    missing = float(np.interp(wanted, kbps, curve.cost))
    return missing * max(1.0, float(kbps[0]) / wanted), finest  # below the smallest bitrate frames are skipped
