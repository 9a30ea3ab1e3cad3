"""The codecs by name. Modules are named as text and imported on first use; a new codec is one file and one line here.

>>> codec_id("pcodec"), codec_name(1)
(3, 'raw')
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Final, NamedTuple, cast

from lidarcodec.codecs.base import Codec, Decoder, Encoder, own_settings
from lidarcodec.errors import (
    MissingCodecError,
    MissingExtraError,
    SettingsError,
    UnknownNameError,
    UnsupportedVersionError,
)
from lidarcodec.settings import StreamSettings


class Entry(NamedTuple):
    """number: in messages, never given to another codec; module: what offers `CODEC`
    package: what the codec codes by, if that is no dependency of the core; extra: brings it
    """

    number: int
    module: str
    package: str | None = None
    extra: str | None = None


_TABLE: Final = {
    "raw": Entry(1, "lidarcodec.codecs.raw"),
    "zstd": Entry(2, "lidarcodec.codecs.zstd"),
    "pcodec": Entry(3, "lidarcodec.codecs.pcodec"),
    "png": Entry(4, "lidarcodec.codecs.png", "imagecodecs", "images"),
    "jxl": Entry(5, "lidarcodec.codecs.jxl", "imagecodecs", "images"),
    "jpeg": Entry(6, "lidarcodec.codecs.jpeg", "imagecodecs", "images"),
    "jpeg-layered": Entry(7, "lidarcodec.codecs.jpeg_layered", "imagecodecs", "images"),
    "h264": Entry(8, "lidarcodec.codecs.h264", "av", "video"),
    "h264-log": Entry(9, "lidarcodec.codecs.h264_log", "av", "video"),
    "riddle": Entry(10, "lidarcodec.codecs.riddle"),
    "predictive": Entry(11, "lidarcodec.codecs.predictive"),
}


def names() -> tuple[str, ...]:
    """Names of all codecs."""
    return tuple(_TABLE)


def entries() -> dict[str, Entry]:
    """The table: entries by name."""
    return dict(_TABLE)


def missing_extra(name: str) -> str | None:
    """The extra without which the codec cannot be used here; None where it can."""
    entry = _TABLE.get(name)
    return None if entry is None or entry.package is None or find_spec(entry.package) is not None else entry.extra


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
    package = _TABLE[name].package
    if package is not None:
        import_module(package)
    return found


def codec_id(name: str) -> int:
    """A codec's number in messages.

    Raises UnknownNameError.
    """
    if name not in _TABLE:
        raise UnknownNameError("codec", name, _TABLE)
    return _TABLE[name].number


def codec_name(number: int) -> str:
    """Name of the codec of that number.

    Raises UnsupportedVersionError if this build has none.
    """
    for name, entry in _TABLE.items():
        if entry.number == number:
            return name
    raise UnsupportedVersionError(f"this build does not know codec {number}: its codecs are {', '.join(_TABLE)}", 12)


@cache
def codec(name: str) -> Codec:
    """What the codec's file offers: settings model, encoder, decoder.

    Raises UnknownNameError.
    """
    codec_id(name)
    return cast(Codec, import_module(_TABLE[name].module).CODEC)


def check(settings: StreamSettings) -> StreamSettings:
    """The settings themselves, if the codec they name can follow them.

    Raises UnknownNameError or SettingsError with the field and the reason.
    """
    chosen = codec(settings.codec)
    own_settings(chosen.settings, settings)
    if settings.max_error_m is not None and not chosen.bounded:
        raise SettingsError(f"codec {settings.codec} cannot keep an error bound: leave max_error_m out", "max_error_m")
    _check_target(settings, chosen)
    if settings.base_error_m is not None and not chosen.layered:
        able = ", ".join(name for name in _TABLE if codec(name).layered)
        raise SettingsError(f"codec {settings.codec} does not support base_error_m: leave it out, or choose one "
        f"of {able}", "base_error_m")  # fmt: skip
    if settings.parts > 1 and not chosen.parts:
        able = ", ".join(name for name in _TABLE if codec(name).parts)
        raise SettingsError(f"codec {settings.codec} cannot send a turn in parts: choose another framing than "
f"{settings.framing}, or one of {able}", "framing")  # fmt: skip
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
