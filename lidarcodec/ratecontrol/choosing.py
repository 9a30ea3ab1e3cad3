"""Which codec `codec=auto` stands for: the one that shows most at the target, of those that encode quickly enough.

What a codec shows at a target is on its operating curve; how long it takes here is measured by others and given. Pure.

>>> wanted = StreamSettings(codec="auto", target_kbps=1000)
>>> ranked(wanted)[:3]
('riddle', 'predictive', 'pcodec')
>>> choice(wanted, {"riddle": 61.0, "predictive": 12.0}, budget_ms=50.0).codec
'predictive'
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError
from lidarcodec.ratecontrol.adaptive import START_KBPS
from lidarcodec.ratecontrol.control import pins_of
from lidarcodec.ratecontrol.curve import RETURNS_A_SECOND, has_curve, operating_curve
from lidarcodec.settings import AUTO, StreamSettings

SHARE: Final = 0.3
"""Part of the time from one frame to the next that encoding may take. Decoding takes about as long, and what is left is
for the path: a frame is not to arrive when the next one is there already."""


class Choice(NamedTuple):
    """codec: a name;  because: of what;  encode_ms: mean of a frame, of each codec that was tried
    budget_ms: what it may take, None as long as it is not known
    """

    codec: str
    because: str
    encode_ms: dict[str, float]
    budget_ms: float | None


def ranked(settings: StreamSettings) -> tuple[str, ...]:
    """Names of the codecs that `auto` chooses from, the one that shows most at the target first; without a target the
    one that takes the fewest bits.

    Only codecs that are installed here, keep a bound, can be steered, were measured and need no process of their own:
    the others show less at every target and take longer, or nobody knows what they show.
    """
    able = [
        name
        for name in table.installed()
        if (codec := table.codec(name)).knob and codec.bounded and not codec.isolated and has_curve(name)
    ]
    return tuple(sorted(able, key=lambda name: _shortcoming(with_codec(settings, name))))


def with_codec(settings: StreamSettings, name: str) -> StreamSettings:
    """The settings with that codec in place of `auto`.

    Raises SettingsError when they hold settings of a codec: which one is not known.
    """
    if settings.codec_settings:
        given = ", ".join(settings.codec_settings)
        raise SettingsError(
            f"codec auto has no settings of its own: leave out {given}, or name a codec", "codec_settings"
        )
    return settings.model_copy(update={"codec": name})


def without_auto(settings: StreamSettings) -> StreamSettings:
    """The settings themselves, or with the first of `ranked` in place of `auto`: the choice where time does not matter.

    Raises SettingsError as `with_codec` does.
    """
    return settings if settings.codec != AUTO else with_codec(settings, ranked(settings)[0])


def choice(settings: StreamSettings, encode_ms: Mapping[str, float], budget_ms: float) -> Choice:
    """The first of `ranked` that keeps to the budget, of those that were tried; else the quickest of them.

    encode_ms: milliseconds of a frame, of each codec that was tried; one at least
    """
    times = {name: round(took, 1) for name, took in encode_ms.items()}
    slower: list[str] = []
    for name in ranked(settings):
        if name not in encode_ms:
            continue
        if encode_ms[name] <= budget_ms:
            most = "gives the best picture" if settings.target_kbps is not None else "takes the fewest bits"
            of = f" of those that encode a frame within {budget_ms:.0f} ms here"
            other = f"; too slow: {', '.join(slower)}" * bool(slower)
            return Choice(name, f"{most}{of} ({times[name]:g} ms){other}", times, budget_ms)
        slower.append(f"{name} ({times[name]:g} ms)")
    quickest = min(encode_ms, key=lambda name: encode_ms[name])
    because = f"the fastest: no codec encodes a frame within {budget_ms:.0f} ms here; tried: {', '.join(slower)}"
    return Choice(quickest, because, times, budget_ms)


def _shortcoming(settings: StreamSettings) -> tuple[float, float]:
    """What is missing from the picture at the target, in metres; and the bits of a return at the finest."""
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
    return missing * max(1.0, float(kbps[0]) / wanted), finest  # below the floor frames are left out
