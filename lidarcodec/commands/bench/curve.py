"""`bench --curve`: measures every codec at several values of its quality setting, for comparable curves. With
`--metrics all` it measures operating curves instead: several target bitrates, where rate control sets all else.

The quality setting ("knob") trades bits for error: the error bound if the codec has one, otherwise `quality` or `crf`.
A codec without any (`raw`) has a single point.

>>> [settings.max_error_m for settings in curve("zstd", ["intensity=off"])][:3]
[0.0, 0.004, 0.01]
>>> curve("jpeg", [])[0].codec_settings
{'quality': 5}
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from lidarcodec.codecs import table
from lidarcodec.commands.settings import sweep
from lidarcodec.errors import SettingsError
from lidarcodec.settings import AUTO, StreamSettings

POINTS: Final[dict[str, tuple[float, ...]]] = {
    "max_error_m": (0.0, 0.004, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0),
    "quality": (5, 10, 20, 35, 50, 65, 80, 90, 95, 98),
    "crf": (0, 3, 6, 9, 12, 15, 18, 22, 26, 32),
}
"""Values of each knob: RMSE from a few millimetres to a metre, about evenly on a logarithmic scale."""
TARGETS_KBPS: Final = (250, 450, 700, 1000, 1500, 2500, 4000, 8000)
"""Targets of an operating curve: from a weak mobile network to nearly all bits of a lossless stream."""


def knob_of(codec: str) -> str | None:
    """The setting that trades a codec's bits for error; None if there is none.

    Raises UnknownNameError.
    """
    found = table.codec(codec)
    own = [name for name in ("quality", "crf") if name in found.settings.model_fields]
    return own[0] if own else "max_error_m" if found.bounded and found.knob is not None else None


def curve(codecs: str | None, pairs: Sequence[str]) -> list[StreamSettings]:
    """Settings for each codec at each point of its knob, for each combination of the other values.

    Raises SettingsError, also if the knob or a target bitrate is given; UnknownNameError.
    """
    names, given = _names(codecs), _given(pairs)
    found = []
    for name in names:
        knob = knob_of(name)
        if knob in given:
            raise SettingsError(f"--curve sets {knob} of {name} itself: leave out --set {knob}, or --curve", knob)
        own = [] if knob is None else [f"{knob}={','.join(f'{value:g}' for value in POINTS[knob])}"]
        found += sweep(name, [*pairs, *own])
    return found


def operating(codecs: str | None, pairs: Sequence[str]) -> list[StreamSettings]:
    """Settings for each codec at each target bitrate, for each combination of the other values; `raw` has one point.

    Raises SettingsError, also if a target bitrate is given; UnknownNameError.
    """
    names = _names(codecs)
    _given(pairs)
    found = []
    for name in names:
        steered = name == AUTO or table.codec(name).knob is not None
        own = [f"target_kbps={','.join(map(str, TARGETS_KBPS))}"] if steered else []
        found += sweep(name, [*pairs, *own])
    return found


def _names(codecs: str | None) -> list[str]:
    names = [name.strip() for name in codecs.split(",")] if codecs else [StreamSettings().codec]
    if "" in names:
        raise SettingsError(f"--codec {codecs}: a name is missing before or after a comma", "codec")
    return names


def _given(pairs: Sequence[str]) -> set[str]:
    """Names of the given settings."""
    given = {pair.partition("=")[0].strip() for pair in pairs}
    if "target_kbps" in given:
        raise SettingsError("--curve sets target_kbps itself: leave out --set target_kbps", "target_kbps")
    return given
