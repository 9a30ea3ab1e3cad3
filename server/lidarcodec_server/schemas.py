"""The data types of REST requests and answers. The OpenAPI document is generated from them."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, TypeGuard

from pydantic import BaseModel, Field

from lidarcodec.errors import LidarCodecError
from lidarcodec.pipeline import check
from lidarcodec.ratecontrol.reach import ReachWarning, columns_warning, missed_warning, reach_warning
from lidarcodec.settings import AUTO, Purpose, StreamSettings
from lidarcodec_server.fleet.answers import State
from lidarcodec_server.fleet.fleet import Stream
from lidarcodec_server.store.store import Entry
from lidarcodec_server.told import images_told


class WarningAnswer(BaseModel):
    """What is wrong with a stream, such as why a target bitrate is not reached, and what to do."""

    code: str = Field(
        description="For programs. `target_out_of_reach`: expected from the settings. `target_missed`, "
        "`frames_left_out` and `columns_left_out` (pinned settings cost most columns): measured, the last one "
        "also expected. `two_publishers`: two of them send under the name of this stream."
    )
    message: str
    remedy: str
    settings: list[str] = Field(
        default=[],
        description="Settings that prevent the target. Settings of the codec are written `codec_settings.NAME`.",
    )
    asked_kbps: float | None = Field(default=None, description="The target.")
    sent_kbps: float | None = Field(default=None, description="Mean over five seconds; null before anything was sent.")
    needed_kbps: float | None = Field(default=None, description="Bitrate that all frames would need, or all columns.")

    @classmethod
    def several(cls, warning: ReachWarning | None) -> list[WarningAnswer]:
        """A list of one warning, or an empty list."""
        return [] if warning is None else [cls(**warning._asdict())]


class StreamAnswer(BaseModel):
    """A stream: its name, whether its publisher is online, the settings in force and its last status (docs/live.md)."""

    vehicle: str
    sensor: str
    alive: bool
    settings: StreamSettings | None = Field(
        description="Settings in force, or the last known ones; null before the vehicle reported any."
    )
    status: dict[str, Any] | None = Field(description="The last status; null before the first one.")
    mount: dict[str, float] | None = Field(
        default=None,
        description="Where the sensor sits on its vehicle: x_m, y_m, z_m, roll_deg, pitch_deg, yaw_deg; null if the "
        "stream does not say.",
    )
    warnings: list[WarningAnswer] = Field(
        default=[],
        description="Whether two publishers send under this name, and why the target bitrate is not reached; empty "
        "without either.",
    )

    @classmethod
    def of(cls, stream: Stream) -> StreamAnswer:
        """From the data of the service."""
        return cls(
            vehicle=stream.keys.vehicle,
            sensor=stream.keys.sensor,
            alive=stream.alive,
            settings=stream.settings,
            status=stream.status,
            mount=(stream.status or {}).get("mount"),
            warnings=_two_publishers(stream) + WarningAnswer.several(_missed(stream)),
        )


def _two_publishers(stream: Stream) -> list[WarningAnswer]:
    """The warning that two publishers have the same name: nobody could say whose settings and figures are shown."""
    if not stream.of_two:
        return []
    message = f"two publishers send as {stream.keys.vehicle}/{stream.keys.sensor}, so points and figures are of both"
    remedy = "end one of them, or give it another name with --vehicle or --sensor"
    return [WarningAnswer(code="two_publishers", message=message, remedy=remedy)]


def _missed(stream: Stream) -> ReachWarning | None:
    """Why a stream does not reach its target. A status from before the last change is not used."""
    settings = stream.settings
    if not stream.alive or settings is None:
        return None
    status = stream.status or {}
    rate = status.get("rate") if status.get("settings") == settings.model_dump() else None
    if settings.codec == AUTO and stream.codec is not None:
        settings = settings.model_copy(update={"codec": stream.codec})
    return missed_warning(settings, rate, images_told(status)) if _known(settings) else None


def _known(settings: StreamSettings | None) -> TypeGuard[StreamSettings]:
    """Whether this version understands settings that a vehicle reported: the vehicle may be newer, or send wrong
    data.
    """
    try:
        return settings is not None and check(settings) is settings
    except LidarCodecError:
        return False


class SettingsAnswer(BaseModel):
    """The settings of a stream."""

    applied: StreamSettings | None = Field(description="Settings in force now; null if the vehicle is away.")
    desired: StreamSettings | None = Field(
        description="All settings once the vehicle has accepted those of operators; null if operators set nothing."
    )
    operator: dict[str, Any] = Field(description="Settings of operators, and the codec to which they belong.")
    refused: str | None = Field(
        description="Why the vehicle does not use them: it refused, or another program changed them."
    )
    first_frame: int | None = Field(
        default=None,
        description="After DELETE, the first frame that can have the vehicle's own settings; otherwise null.",
    )

    @classmethod
    def of(cls, state: State) -> SettingsAnswer:
        """From the state of a stream's settings."""
        desired = None if state.desired is None else StreamSettings.model_validate(state.desired)
        return cls(
            applied=state.applied,
            desired=desired,
            operator=state.operator,
            refused=state.refused,
            first_frame=state.first_frame,
        )


class ChangeAnswer(BaseModel):
    """The result of a change."""

    applied: StreamSettings | None = Field(
        description="In force from `first_frame` on; null: the vehicle gets them later."
    )
    desired: StreamSettings | None = Field(description="All settings once the vehicle has accepted the change.")
    first_frame: int | None = Field(description="The first frame that can have the new settings.")
    warnings: list[WarningAnswer] = Field(
        default=[], description="Settings that cannot be met, such as a target bitrate that is out of reach."
    )

    @classmethod
    def of(cls, state: State) -> ChangeAnswer:
        """From the state of a stream's settings after a change."""
        desired = None if state.desired is None else StreamSettings.model_validate(state.desired)
        in_force = state.applied or desired
        expected = None
        if _known(in_force):
            expected = reach_warning(in_force, state.images) or columns_warning(in_force, state.images)
        warnings = WarningAnswer.several(expected)
        return cls(applied=state.applied, desired=desired, first_frame=state.first_frame, warnings=warnings)


class KeyFrameAnswer(BaseModel):
    """A key frame was requested."""

    first_frame: int = Field(description="The first frame that can be the key frame.")
    merged: bool = Field(description="Whether there was already such a request.")


class AuditEntry(BaseModel):
    """Who changed what, and when."""

    id: int
    vehicle: str = Field(description="Empty for entries without a stream, for example a new token.")
    sensor: str
    at: datetime
    who: str = Field(
        description="Name of the token; a host if no token was needed; `server` if the server restored settings."
    )
    action: str = Field(description="`settings`, `keyframe`, `record`, `play` and so on (docs/server.md).")
    changes: dict[str, Any] = Field(description="The requested change.")
    old: dict[str, Any] | None = Field(description="The settings before, if they are known.")
    new: dict[str, Any] | None = Field(description="The settings in force after it.")
    result: str = Field(
        description="`applied`; `stored`: the vehicle was away; `refused`; `overridden`: another program changed "
        "it; `done`; `sent`: not known."
    )
    reason: str | None
    first_frame: int | None

    @classmethod
    def of(cls, entry: Entry) -> AuditEntry:
        """From the store."""
        values = entry._asdict()
        at = datetime.fromtimestamp(values.pop("at_ns") / 1e9, UTC)
        return cls(at=at, **values)


class Reach(BaseModel):
    """Bitrates that a codec is expected to reach: the mean of two KITTI drives. A stream's status has the values of its
    own scene, in `rate.reachable_kbps`."""

    setting: str = Field(
        description="The setting that a target bitrate adjusts: `max_error_m`, or a setting of the codec."
    )
    coarsest: float
    finest: float
    range_bits_per_return: tuple[float, float] = Field(description="Ranges only, coarsest and finest.")
    range_kbps: tuple[float, float] = Field(
        description="The same in kbit/s, at 10 frames a second with 110,000 returns. Mask and intensity come on top."
    )
    kbps: tuple[float, float] = Field(description="Everything together: possible targets.")


class CodecAnswer(BaseModel):
    """A codec."""

    name: str
    bound: bool = Field(description="Whether the codec supports `max_error_m`.")
    target: bool = Field(description="Whether the codec supports `target_kbps`.")
    clouds: bool = Field(description="Whether it takes point clouds that a driver made.")
    settings_schema: dict[str, Any] = Field(description="JSON schema of its `codec_settings`.")
    reach: Reach | None = Field(description="Null if the codec supports no target, or was not measured.")


class LinkSettings(BaseModel):
    """The settings of a preset: the body of a PATCH of a stream's settings."""

    purpose: Purpose
    codec: str
    target_kbps: float | None


class LinkAnswer(BaseModel):
    """A preset for streams over a link."""

    name: str = Field(description="The name used by `publish --link`.")
    label: str = Field(description="For people.")
    settings: LinkSettings
