"""The codecs by name. Modules are named as text and imported on first use; a new codec is one file and one line here.

>>> codec_id("pcodec"), codec_name(1)
(3, 'raw')
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Final, cast

from lidarcodec.codecs.base import Codec, Decoder, Encoder, own_settings
from lidarcodec.errors import SettingsError, UnknownNameError, UnsupportedVersionError
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


def names() -> tuple[str, ...]:
    """Names of all codecs."""
    return tuple(_TABLE)


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
    """Try the files on this machine that settings name, such as weights. The settings have been checked before.

    Raises SettingsError.
    """
    files = codec(settings.codec).files
    if files is not None:
        files(settings)


def _check_target(settings: StreamSettings, chosen: Codec) -> None:
    if settings.target_kbps is not None and chosen.knob is None:
        able = ", ".join(name for name in names() if codec(name).knob is not None)
        raise SettingsError(f"codec {settings.codec} cannot keep a target bitrate: leave target_kbps out, or "
f"choose one of {able}", "target_kbps")  # fmt: skip


def make_encoder(settings: StreamSettings, stream_id: int) -> Encoder:
    """A fresh encoder; its first message will be a key message.

    Raises as `check` does.
    """
    return codec(check(settings).codec).encoder(codec_id(settings.codec), settings, stream_id)


def make_decoder(number: int) -> Decoder:
    """A fresh decoder of the codec of that number.

    Raises UnsupportedVersionError.
    """
    return codec(codec_name(number)).decoder(number)
