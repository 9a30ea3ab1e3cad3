"""Turns `--codec` and `--set key=value` into StreamSettings. A key is a field of StreamSettings if it has one of that
name, otherwise a setting of the codec.

>>> one_setting("zstd", ["level=9", "max_error_m=0.01"]).codec_settings
{'level': 9}
>>> [s.max_error_m for s in sweep("zstd,pcodec", ["max_error_m=0,0.02"])]
[0.0, 0.02, 0.0, 0.02]
>>> one_setting("predictive", [], link="2mbit").target_kbps
1600.0
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Final

from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError, unknown_name
from lidarcodec.pipeline import check, check_offline
from lidarcodec.ratecontrol.presets import preset
from lidarcodec.settings import StreamSettings, settings_from

SHORT_NUMBER: Final = re.compile(r"[+-]?([0-9]+\.[0-9]*|\.[0-9]+)(e[+-]?[0-9]{1,3})?", re.IGNORECASE)
"""Forms of numbers that people write but JSON does not allow."""
TEXTS: Final = frozenset(
    key for key, field in StreamSettings.model_fields.items() if field.annotation in (str, str | None)
)
"""Settings with a text value, even if the text looks like a number: `follow=7`."""


def one_setting(codec: str | None, pairs: Sequence[str], link: str | None = None) -> StreamSettings:
    """Valid settings of a codec. link: name of a preset for all settings that are not given

    Raises SettingsError with the key, or UnknownNameError.
    """
    return _settings(codec, [_key_and_text(pair) for pair in pairs], link)


def sweep(codecs: str | None, pairs: Sequence[str]) -> list[StreamSettings]:
    """Settings for each codec (names with commas between) and each combination of values (`key=a,b,c`).

    Raises SettingsError with the key, or UnknownNameError, before anything is measured.
    """
    names: list[str | None] = [name.strip() for name in codecs.split(",")] if codecs else [None]
    if "" in names:
        raise SettingsError(f"--codec {codecs}: a name is missing before or after a comma", "codec")
    choices = [[(key, value) for value in text.split(",")] for key, text in map(_key_and_text, pairs)]
    return [check_offline(_settings(name, chosen)) for name in names for chosen in product(*choices)]


def _key_and_text(pair: str) -> tuple[str, str]:
    key, equals, text = pair.partition("=")
    if not equals or not key.strip():
        raise SettingsError(f"--set {pair}: write it as key=value")
    return key.strip(), text.strip()


def _value(key: str, text: str) -> Any:
    """The value of a text: the text itself for settings with a text value, otherwise a JSON scalar, a number like
    .5, or the text if it is neither."""
    if key in TEXTS and text != "null":
        return text
    if SHORT_NUMBER.fullmatch(text):
        return float(text)
    try:
        value = json.loads(text)
    except ValueError:
        return text
    return text if isinstance(value, dict | list) else value


def _settings(codec: str | None, pairs: Sequence[tuple[str, str]], link: str | None = None) -> StreamSettings:
    values: dict[str, Any] = {}
    for key, text in pairs:
        if key in values or (key == "codec" and codec):
            raise SettingsError(f"--set {key}={text}: {key} is given twice", key)
        values[key] = _value(key, text)
    return settings_of(codec, values, link)


def settings_of(codec: str | None, values: Mapping[str, Any], link: str | None = None) -> StreamSettings:
    """Settings of a codec from plain values: fields of StreamSettings, otherwise settings of the codec.

    link: name of a preset; given values override it
    Raises SettingsError with the key, UnknownNameError, or MissingExtraError.
    """
    common: dict[str, Any] = {} if link is None else preset(link).settings
    target = common.get("target_kbps")
    if target is not None and values.get("base_error_m") is not None and "target_kbps" not in values:
        raise SettingsError(
            f"base_error_m cannot be combined with a target bitrate, and --link {link} sets "
            f"target_kbps={target:g}: leave out --link",
            "base_error_m",
        )
    common |= {"codec": codec} if codec else {}
    own: dict[str, Any] = {}
    for key, value in values.items():
        is_common = key in StreamSettings.model_fields and key != "codec_settings"
        (common if is_common else own)[key] = value
    settings = settings_from(common | {"codec_settings": own})
    try:
        check(settings)
    except SettingsError as error:
        for key in _unknown(settings):
            if error.field == f"codec_settings.{key}" and settings.codec in table.names():
                of_all = [name for name in StreamSettings.model_fields if name != "codec_settings"]
                known = (*table.codec(settings.codec).settings.model_fields, *of_all)
                raise SettingsError(unknown_name("setting", key, known), error.field) from None
        raise
    table.check_installed(settings.codec)
    return settings


def _unknown(settings: StreamSettings) -> set[str]:
    """Keys of `codec_settings` that the codec does not have. `auto` has none of its own."""
    known = table.codec(settings.codec).settings.model_fields if settings.codec in table.names() else {}
    return set(settings.codec_settings) - set(known)
