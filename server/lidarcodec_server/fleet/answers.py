"""What a vehicle answers to a change of settings, and what a stream's settings are then."""

from __future__ import annotations

from typing import Any, NamedTuple

from lidarcodec.errors import LidarCodecError, SettingsError
from lidarcodec.ratecontrol.image_curve import ImageKind
from lidarcodec.settings import StreamSettings


class RefusedError(SettingsError):
    """The vehicle refused a change; nothing changed."""


class AwayError(LidarCodecError):
    """The vehicle is away, or does not answer."""


class Applied(NamedTuple):
    """A vehicle's answer to a change."""

    settings: StreamSettings
    first_frame: int | None


class State(NamedTuple):
    """The settings of a stream.

    applied:  current settings, None when the vehicle is away
    desired:  all settings of the stream once it has those of operators, None if operators set nothing
    operator: the settings that operators set;  refused: why the vehicle does not use them
    images:   of the sensor, if it is not an HDL-64E
    """

    applied: StreamSettings | None
    desired: dict[str, Any] | None
    operator: dict[str, Any]
    first_frame: int | None = None
    refused: str | None = None
    images: ImageKind | None = None
