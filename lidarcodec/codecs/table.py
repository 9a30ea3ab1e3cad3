"""The codecs by name. Modules are named as text and imported on first use; a new codec is one file and one line here.

>>> codec_id("pcodec"), codec_name(1)
(3, 'raw')
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Final, cast

from lidarcodec.codecs.base import Codec, Decoder, Encoder, own_settings
from lidarcodec.errors import (
    MissingCodecError,
    MissingExtraError,
    SettingsError,
    UnknownNameError,
    UnsupportedVersionError,
)
from lidarcodec.settings import StreamSettings

_TABLE: Final[dict[str, tuple[int, str]]] = {
    "raw": (1, "lidarcodec.codecs.raw"),
    "zstd": (2, "lidarcodec.codecs.zstd"),
    "pcodec": (3, "lidarcodec.codecs.pcodec"),
    "png": (4, "lidarcodec.codecs.png"),
    "jxl": (5, "lidarcodec.codecs.jxl"),
    "jpeg": (6, "lidarcodec.codecs.jpeg"),
    "jpeg-layered": (7, "lidarcodec.codecs.jpeg_layered"),
    "h264": (8, "lidarcodec.codecs.h264"),
    "h264-log": (9, "lidarcodec.codecs.h264_log"),
    "riddle": (10, "lidarcodec.codecs.riddle"),
    "predictive": (11, "lidarcodec.codecs.predictive"),
}
"""Name: number in messages, never given to another codec; module."""
_NEEDED: Final[dict[str, tuple[str, str]]] = {
    "png": ("imagecodecs", "images"),
    "jxl": ("imagecodecs", "images"),
    "jpeg": ("imagecodecs", "images"),
    "jpeg-layered": ("imagecodecs", "images"),
    "h264": ("av", "video"),
    "h264-log": ("av", "video"),
}
"""Name: the package that it codes by; the extra that brings it. What a codec's file offers is there without."""


def names() -> tuple[str, ...]:
    """Names of all codecs."""
    return tuple(_TABLE)


def missing_extra(name: str) -> str | None:
    """The extra without which the codec cannot be used here; None where it can."""
    package, extra = _NEEDED.get(name, (None, None))
    return None if package is None or find_spec(package) is not None else extra


def installed() -> tuple[str, ...]:
    """Names of the codecs that can be used here."""
    return tuple(name for name in _TABLE if missing_extra(name) is None)


def check_installed(name: str) -> None:
    """Raise MissingExtraError unless the codec of that name can be used here."""
    extra = missing_extra(name)
    if extra is not None:
        raise MissingExtraError(f"codec {name}", extra)


def load(name: str) -> Codec:
    """What the codec's file offers, with the package that it codes by imported.

    Raises UnknownNameError, MissingExtraError.
    """
    found = codec(name)
    check_installed(name)
    if name in _NEEDED:
        import_module(_NEEDED[name][0])
    return found


def codec_id(name: str) -> int:
    """A codec's number in messages.

    Raises UnknownNameError.
    """
    if name not in _TABLE:
        raise UnknownNameError("codec", name, _TABLE)
    return _TABLE[name][0]


def codec_name(number: int) -> str:
    """Name of the codec of that number.

    Raises UnsupportedVersionError if this build has none.
    """
    for name, (known, _) in _TABLE.items():
        if known == number:
            return name
    raise UnsupportedVersionError(f"this build does not know codec {number}: its codecs are {', '.join(_TABLE)}", 12)


@cache
def codec(name: str) -> Codec:
    """What the codec's file offers: settings model, encoder, decoder.

    Raises UnknownNameError.
    """
    codec_id(name)
    return cast(Codec, import_module(_TABLE[name][1]).CODEC)


def check(settings: StreamSettings) -> StreamSettings:
    """The settings themselves, if the codec they name can follow them.

    Raises UnknownNameError or SettingsError with the field and the reason.
    """
    chosen = codec(settings.codec)
    own_settings(chosen.settings, settings)
    if settings.max_error_m is not None and not chosen.bounded:
        raise SettingsError(f"codec {settings.codec} cannot keep an error bound: leave max_error_m out", "max_error_m")
    _check_target(settings, chosen)
    return settings


def check_files(settings: StreamSettings) -> None:
    """Try what settings need of this machine: packages, and files such as weights. They have been checked before.

    Raises MissingExtraError, SettingsError.
    """
    check_installed(settings.codec)
    files = codec(settings.codec).files
    if files is not None:
        files(settings)


def _check_target(settings: StreamSettings, chosen: Codec) -> None:
    if settings.target_kbps is not None and chosen.knob is None:
        able = ", ".join(name for name in installed() if codec(name).knob is not None)
        raise SettingsError(f"codec {settings.codec} cannot keep a target bitrate: leave target_kbps out, or "
f"choose one of {able}", "target_kbps")  # fmt: skip


def make_encoder(settings: StreamSettings, stream_id: int) -> Encoder:
    """A fresh encoder; its first message will be a key message.

    Raises as `check` does, and MissingExtraError.
    """
    return load(check(settings).codec).encoder(codec_id(settings.codec), settings, stream_id)


def decodable(number: int) -> str:
    """Name of the codec of that number, if it can be used here.

    Raises UnsupportedVersionError, MissingCodecError among them.
    """
    name = codec_name(number)
    extra = missing_extra(name)
    if extra is not None:
        raise MissingCodecError(f"decoding codec {name}", extra)
    return name


def make_decoder(number: int) -> Decoder:
    """A fresh decoder of the codec of that number.

    Raises as `decodable` does.
    """
    return load(decodable(number)).decoder(number)
