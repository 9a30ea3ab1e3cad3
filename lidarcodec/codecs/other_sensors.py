"""Frames of other sensors than the HDL-64E: which codecs take them, and with which settings.

A message has a PLANES section with all images and a REST section with what else its packets hold. Most codecs code all
images alike: how is in `KINDS`. Codecs of pictures have an encoder and a decoder of their own (`Codec.others`).
"""

from __future__ import annotations

from typing import Final

from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder, Encoder
from lidarcodec.codecs.frame_encoder import FrameEncoder
from lidarcodec.codecs.other_decoder import PlaneDecoder
from lidarcodec.codecs.plane_content import PlaneContent
from lidarcodec.errors import SettingsError, UnsupportedVersionError
from lidarcodec.planes.plane_section import PlaneKind
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import AUTO, StreamSettings

KINDS: Final = {
    "raw": PlaneKind.PLAIN,
    "zstd": PlaneKind.ZSTD,
    "pcodec": PlaneKind.QUICK,
    "predictive": PlaneKind.MODELLED,
    "riddle": PlaneKind.FOLLOWING,
}
"""Codec -> how it codes all planes of other sensors, ranges among them. `auto` chooses among these."""


def takes_others(codec: str) -> bool:
    """Whether a codec takes frames of other sensors than the HDL-64E.

    Raises UnknownNameError.
    """
    return codec in KINDS or table.codec(codec).others is not None


def check_other(settings: StreamSettings) -> StreamSettings:
    """The settings themselves, if frames of other sensors than the HDL-64E can be coded with them.

    Raises SettingsError with the field and what to do.
    """
    if settings.codec != AUTO and not takes_others(settings.codec):
        able = ", ".join(name for name in table.names() if takes_others(name))
        raise SettingsError(
            f"codec {settings.codec} works only with an HDL-64E: for this sensor choose one of {able}", "codec"
        )
    if settings.base_error_m is not None:
        raise SettingsError("base_error_m works only with an HDL-64E: leave it out", "base_error_m")
    return settings


def check_for(sensor: SensorModel, settings: StreamSettings) -> StreamSettings:
    """The settings themselves, if frames of this sensor can be coded with them.

    Raises SettingsError with the field and what to do.
    """
    if sensor.is_cloud:
        if settings.codec not in (*KINDS, AUTO):
            text = f"codec {settings.codec} takes no point clouds: choose one of {', '.join(KINDS)}"
            raise SettingsError(text, "codec")
        if settings.intensity not in (AUTO, "lossless"):
            text = f"the fields of a point cloud travel as they are: leave intensity={settings.intensity} out"
            raise SettingsError(text, "intensity")
        if settings.reduces:
            text = f"all points of a point cloud are sent: leave reduction={settings.reduction} out"
            raise SettingsError(text, "reduction")
        if settings.target_kbps is not None:
            text = "a point cloud cannot keep a target bitrate: leave target_kbps out, and set max_error_m to send less"
            raise SettingsError(text, "target_kbps")
    return settings if sensor.is_hdl64e else check_other(settings)


def other_encoder(settings: StreamSettings, stream_id: int) -> Encoder:
    """An encoder of frames of other sensors than the HDL-64E.

    Raises SettingsError as `check_other` does, MissingExtraError.
    """
    check_other(settings)
    codec, number = table.load(settings.codec), table.codec_id(settings.codec)
    if codec.others is not None:
        return codec.others.encoder(number, settings, stream_id)
    return FrameEncoder(number, settings, stream_id, codec.settings, PlaneContent(KINDS[settings.codec]))


def other_decoder(number: int) -> Decoder:
    """A decoder of messages of other sensors than the HDL-64E, of the codec of that number.

    Raises UnsupportedVersionError for a codec that does not write such messages, MissingCodecError among them.
    """
    name = table.codec_name(number)
    if name in KINDS:
        return PlaneDecoder(number)
    others = table.load(table.decodable(number)).others
    if others is None:
        raise UnsupportedVersionError(f"codec {name} does not write frames of this sensor")
    return others.decoder(number)
