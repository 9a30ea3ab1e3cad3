"""Recordings: starting and stopping a recording of a stream, listing recordings, and playing one as a stream."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Body, Path, Response
from pydantic import BaseModel, ConfigDict, Field

from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.settings import MAX_NAME, NAME_PATTERN, settings_from
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.auth import Viewer
from lidarcodec_server.live.download import MEDIA_TYPE
from lidarcodec_server.live.playback import PlayRequest
from lidarcodec_server.live.running import Limits
from lidarcodec_server.live.shelf import (
    BusyRecordingError,
    MissingRecordingError,
    Recording,
    ShelfError,
    State,
    StorageError,
)
from lidarcodec_server.operations import Operation, operates
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.routes.common import TheService, TheStream, time_of
from lidarcodec_server.routes.live import Known, TheDownloads, TheRecordings
from lidarcodec_server.service import Service
from lidarcodec_server.told import check_names, check_settings_size

router = APIRouter(prefix="/api/v1", tags=["recordings"])

Id = Annotated[str, Path(max_length=64, examples=["20261121T101500Z-3fa2c9"])]
NO_SUCH: dict[int | str, dict[str, Any]] = {404: {"description": "No such stream, or no such recording."}}
BUSY: dict[int | str, dict[str, Any]] = {
    409: {"description": "It is being recorded or played, or a name is already used."}
}
FULL: dict[int | str, dict[str, Any]] = {
    507: {"description": "The folder is full or cannot be written, or the disk does not respond."}
}


class RecordBody(BaseModel):
    """When a recording ends by itself; at the latest at the server's limits."""

    model_config = ConfigDict(extra="forbid")

    max_seconds: float = Field(default=3600.0, gt=0.0, le=1e9)
    max_bytes: int = Field(default=4 * 2**30, ge=1, le=2**60)


class PlayBody(BaseModel):
    """The stream as which a recording is played."""

    model_config = ConfigDict(extra="forbid")

    vehicle: str | None = Field(
        default=None, pattern=f"^{NAME_PATTERN.pattern}$", max_length=MAX_NAME, description="By default `playback-ID`."
    )
    sensor: str | None = Field(
        default=None,
        pattern=f"^{NAME_PATTERN.pattern}$",
        max_length=MAX_NAME,
        description="By default that of the recording.",
    )
    rate: float = Field(default=10.0, ge=0.1, le=100.0, description="Frames of 348 packets a second.")
    loop: bool = Field(default=False, description="Start again at the end.")
    settings: dict[str, Any] = Field(default_factory=dict, description="Settings of the stream, as in PATCH.")


class SteerBody(BaseModel):
    """A change of a playback; fields that are left out stay as they are."""

    model_config = ConfigDict(extra="forbid")

    paused: bool | None = Field(default=None, description="Pause or continue.")
    position_s: float | None = Field(
        default=None, ge=0.0, le=1e9, description="Continue from here, in seconds of the recording."
    )
    rate: float | None = Field(default=None, ge=0.1, le=100.0, description="Frames of 348 packets a second.")
    loop: bool | None = Field(default=None, description="Start again at the end.")


class PlayingAnswer(BaseModel):
    """A playback: its stream and its position."""

    vehicle: str
    sensor: str
    rate: float
    loop: bool
    paused: bool
    position_s: float = Field(description="Current position, in seconds of the recording.")
    duration_s: float = Field(description="Length of the recording in seconds.")
    since: datetime
    frames: int
    source: dict[str, int] = Field(description="Faults found in the recording, by cause.")

    @classmethod
    def of(cls, state: dict[str, Any]) -> PlayingAnswer:
        """From the state of the playback."""
        return cls(
            since=time_of(state["since_ns"]), **{name: value for name, value in state.items() if name != "since_ns"}
        )


class RecordingAnswer(BaseModel):
    """A recording. `recording`: it is running in this server, or in another server with this folder (see `reason`).

    `interrupted`: its server stopped during the recording; everything before that is there.
    """

    id: str
    vehicle: str
    sensor: str
    started: datetime
    ended: datetime | None
    state: State
    reason: str | None = Field(description="Why it ended, unless a user stopped it; or which server is recording it.")
    by: str | None = Field(description="Who started it.")
    size_bytes: int
    frames: int | None = Field(description="Null if they were not counted.")
    playing: PlayingAnswer | None

    @classmethod
    def of(cls, recording: Recording, playing: dict[str, Any] | None) -> RecordingAnswer:
        """From the data of the shelf."""
        return cls(
            id=recording.id,
            vehicle=recording.vehicle,
            sensor=recording.sensor,
            started=time_of(recording.started_ns),
            ended=None if recording.ended_ns is None else time_of(recording.ended_ns),
            state=recording.state,
            reason=recording.reason,
            by=recording.by,
            size_bytes=recording.size_bytes,
            frames=recording.frames,
            playing=None if playing is None else PlayingAnswer.of(playing),
        )


@router.post("/streams/{vehicle}/{sensor}/recording", status_code=201, responses={**NO_SUCH, **BUSY, **FULL})
async def start(
    operation: Annotated[Operation, operates("record")],
    known: Known,
    recordings: TheRecordings,
    body: Annotated[RecordBody | None, Body()] = None,
) -> RecordingAnswer:
    """Record a stream on the server, as the vehicle sends it, until it is stopped or a limit is reached."""
    limits = None if body is None else Limits(body.max_seconds, body.max_bytes)
    with recording_problems():
        started = await recordings.start(known.keys, operation.client.name, limits)
    operation.about = {"recording": started.id}
    return RecordingAnswer.of(started, None)


@router.get("/streams/{vehicle}/{sensor}/recording", responses=NO_SUCH)
async def running(recordings: TheRecordings, keys: TheStream, client: Viewer) -> RecordingAnswer:
    """The running recording of a stream."""
    found = recordings.of(keys)
    if found is None:
        raise ProblemError(404, f"{keys.vehicle}/{keys.sensor} is not being recorded", "unknown-recording")
    return RecordingAnswer.of(found, None)


@router.delete("/streams/{vehicle}/{sensor}/recording", responses={**NO_SUCH, **FULL})
async def stop(
    recordings: TheRecordings, keys: TheStream, operation: Annotated[Operation, operates("record-stop")]
) -> RecordingAnswer:
    """End the recording of a stream. The answer comes when everything is on the disk."""
    with recording_problems():
        ended = await recordings.stop(keys)
    operation.about = {"recording": ended.id}
    return RecordingAnswer.of(ended, None)


@router.get("/recordings", responses=FULL)
async def all_recordings(recordings: TheRecordings, client: Viewer) -> list[RecordingAnswer]:
    """All recordings, newest first."""
    with recording_problems():
        return [RecordingAnswer.of(one, recordings.playing(one.id)) for one in await recordings.all()]


@router.get("/recordings/{id}", responses=NO_SUCH)
async def one_recording(recordings: TheRecordings, id: Id, client: Viewer) -> RecordingAnswer:
    """One recording."""
    with recording_problems():
        return RecordingAnswer.of(await recordings.one(id), recordings.playing(id))


RANGES: dict[int | str, dict[str, Any]] = {
    200: {"description": "The MCAP file.", "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}},
    206: {"description": "The ranges of it that were asked for."},
    416: {"description": "A range behind its end."},
    429: {"description": "Too many downloads are running."},
}


@router.get("/recordings/{id}/download", response_class=Response, responses={**RANGES, **NO_SUCH, **BUSY, **FULL})
async def download(recordings: TheRecordings, downloads: TheDownloads, id: Id, client: Viewer) -> Response:
    """The bytes of a recording. A download that was cut can be continued: headers `Range` and `If-Range` (RFC 9110)."""
    give_back = downloads.take(client.name)
    try:
        with recording_problems():
            return await recordings.download(id, give_back)
    except BaseException:
        give_back()
        raise


@router.delete("/recordings/{id}", status_code=204, responses={**NO_SUCH, **BUSY, **FULL})
async def remove(recordings: TheRecordings, id: Id, operation: Annotated[Operation, operates("record-delete")]) -> None:
    """Delete a recording for good."""
    with recording_problems():
        gone = await recordings.one(id)
        operation.keys = StreamKeys(gone.vehicle, gone.sensor)
        await recordings.remove(id)


@router.post("/recordings/{id}/play", status_code=201, responses={**NO_SUCH, **BUSY})
async def play(
    service: TheService,
    recordings: TheRecordings,
    id: Id,
    operation: Annotated[Operation, operates("play")],
    body: Annotated[PlayBody | None, Body()] = None,
) -> PlayingAnswer:
    """Play a recording as a stream of its own. It can then be viewed and changed like any other stream."""
    wanted = checked(body)
    with recording_problems():
        recording = await recordings.one(id)
        playing = await recordings.play(id, play_request(service, operation, wanted, id, recording.sensor))
    return PlayingAnswer.of(playing)


def checked(body: PlayBody | None) -> PlayBody:
    """A body whose settings are not too large. Raises SettingsError."""
    wanted = body or PlayBody()
    check_settings_size(wanted.settings)
    check_names(wanted.settings.get("codec_settings"))
    return wanted


def play_request(service: Service, operation: Operation, wanted: PlayBody, name: str, sensor: str) -> PlayRequest:
    """How to play the recording of that name and sensor. Raises BusyRecordingError, SettingsError."""
    keys = StreamKeys(wanted.vehicle or f"playback-{name}", wanted.sensor or sensor)
    operation.keys = keys
    there = service.fleet.get(keys)
    if there is not None and there.alive:
        raise BusyRecordingError(f"there is already a stream {keys.vehicle}/{keys.sensor}: choose another name")
    return PlayRequest(keys.vehicle, keys.sensor, wanted.rate, wanted.loop, settings_from(wanted.settings))


@router.get("/recordings/{id}/play")
async def played(recordings: TheRecordings, id: Id, client: Viewer) -> PlayingAnswer | None:
    """The playback of a recording, or of a segment of the archive; null if it is not played."""
    playing = recordings.playing(id)
    return None if playing is None else PlayingAnswer.of(playing)


@router.patch("/recordings/{id}/play", responses=NO_SUCH)
async def steer(
    recordings: TheRecordings, id: Id, operation: Annotated[Operation, operates("play-steer")], body: SteerBody
) -> PlayingAnswer:
    """Pause a playback, move it, or change its speed or loop, from its next frame on."""
    operation.about |= body.model_dump(exclude_none=True)
    with recording_problems():
        playing = recordings.steer(id, **body.model_dump())
    operation.keys = StreamKeys(playing["vehicle"], playing["sensor"])
    return PlayingAnswer.of(playing)


@router.delete("/recordings/{id}/play", status_code=204, responses={**NO_SUCH, **FULL})
async def stop_playing(
    recordings: TheRecordings, id: Id, operation: Annotated[Operation, operates("play-stop")]
) -> None:
    """End a playback."""
    with recording_problems():
        played = recordings.playing(id)
        await recordings.stop_playing(id)
    if played is not None:
        operation.keys = StreamKeys(played["vehicle"], played["sensor"])


@contextmanager
def recording_problems() -> Iterator[None]:
    """Turns errors of recordings into problems."""
    try:
        yield
    except MissingRecordingError as error:
        raise ProblemError(404, str(error), "unknown-recording") from None
    except BusyRecordingError as error:
        raise ProblemError(409, str(error), "busy") from None
    except (StorageError, ShelfError) as error:
        raise ProblemError(507, str(error), "storage") from None
    except (SourceError, DecodeError) as error:
        raise ProblemError(422, f"the recording cannot be played: {error}", "recording") from None
