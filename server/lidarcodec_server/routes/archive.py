"""An archive: its segments by vehicle, time and place, downloaded and played."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from typing import Annotated, Any, cast

from fastapi import APIRouter, Body, Depends, Path, Query, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection

from lidarcodec.archive.archive import time_ns
from lidarcodec.errors import SettingsError
from lidarcodec.settings import MAX_NAME, NAME_PATTERN
from lidarcodec_server.archived.archived import Archived
from lidarcodec_server.archived.errors import (
    AwayArchiveError,
    BusyArchiveError,
    DamagedArchiveError,
    FullError,
    NoSegmentError,
)
from lidarcodec_server.archived.finding import Found, Wanted, place_of
from lidarcodec_server.auth import Viewer
from lidarcodec_server.live.download import Download
from lidarcodec_server.operations import Operation, operates
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.routes.common import TheService, time_of
from lidarcodec_server.routes.live import TheDownloads, TheRecordings
from lidarcodec_server.routes.recordings import (
    BUSY,
    RANGES,
    PlayBody,
    PlayingAnswer,
    checked,
    play_request,
    recording_problems,
)

router = APIRouter(prefix="/api/v1", tags=["archive"])

MOST = 200
Segment = Annotated[str, Path(pattern="^[0-9a-f]{24}$", examples=["0f3a5c7e9b1d2f4a6c8e0b1d"])]
Name = Annotated[str | None, Query(pattern=f"^{NAME_PATTERN.pattern}$", max_length=MAX_NAME)]
Time = Annotated[
    str | None, Query(max_length=64, description="RFC 3339, UTC without a zone, or nanoseconds since 1970.")
]
NO_SUCH: dict[int | str, dict[str, Any]] = {
    404: {"description": "The server has no archive, or the archive no such segment."},
    507: {"description": "The archive is damaged there, or the server has no room or no working disk for a copy."},
}


class SegmentAnswer(BaseModel):
    """A segment of an archive: a recording of 40 s or less."""

    segment: str
    vehicle: str
    sensor: str
    begin: datetime
    end: datetime
    frames: int
    bytes: int = Field(description="Of its frames, as coded.")
    codec: str
    bound_m: float | None = Field(description="Largest allowed error of a range in metres; null if there is none.")
    object: str = Field(description="Name of its recording in the archive.")
    playing: PlayingAnswer | None

    @classmethod
    def of(cls, found: Found, playing: dict[str, Any] | None) -> SegmentAnswer:
        """From the index."""
        values = found._asdict()
        begin, end = time_of(values.pop("begin_ns")), time_of(values.pop("end_ns"))
        return cls(**values, begin=begin, end=end, playing=None if playing is None else PlayingAnswer.of(playing))


class SegmentsAnswer(BaseModel):
    """Segments, the newest first."""

    segments: list[SegmentAnswer]
    next: str | None = Field(description="Value of `after` for the next ones; null if these are the last.")
    lost: int = Field(description="Segments of the whole archive whose tables are lost: no search finds them.")


def archived_of(connection: HTTPConnection) -> Archived:
    """The archive of the app. Raises ProblemError 404 if it has none."""
    found = cast(Archived | None, connection.app.state.archived)
    if found is None:
        raise ProblemError(404, "the server has no archive: start it with --archive URL", "no-archive")
    return found


TheArchive = Annotated[Archived, Depends(archived_of)]


@router.get("/archive", responses=NO_SUCH)
async def segments(
    client: Viewer,
    archive: TheArchive,
    recordings: TheRecordings,
    vehicle: Name = None,
    sensor: Name = None,
    begin: Annotated[Time, Query(alias="from")] = None,
    end: Annotated[Time, Query(alias="to")] = None,
    around: Annotated[
        str | None, Query(max_length=64, description="X,Y in metres, in the frame of the poses.", examples=["120,-35"])
    ] = None,
    radius: Annotated[float, Query(ge=0.0, le=1e7, allow_inf_nan=False, description="Metres around that place.")] = 100,
    limit: Annotated[int, Query(ge=1, le=MOST)] = 50,
    after: Annotated[str | None, Query(max_length=64, description="`next` of an earlier answer.")] = None,
) -> SegmentsAnswer:
    """Segments of the archive that have frames of a vehicle, a time and a place, the newest first."""
    from_ns, to_ns = _time(begin, "from"), _time(end, "to")
    if from_ns is not None and to_ns is not None and from_ns > to_ns:
        raise SettingsError("'from' is later than 'to'", "from")
    place = None if around is None else place_of(around)
    with _problems():
        found = await archive.find(Wanted(vehicle, sensor, from_ns, to_ns, place, radius, limit, after), client.name)
    answers = [SegmentAnswer.of(one, recordings.playing(one.segment)) for one in found.segments]
    return SegmentsAnswer(segments=answers, next=found.next, lost=found.lost)


@router.get("/archive/{segment}/download", response_class=Response, responses={**RANGES, **NO_SUCH})
async def download(client: Viewer, archive: TheArchive, downloads: TheDownloads, segment: Segment) -> Response:
    """The recording of a segment. A download that was cut can be continued: headers `Range` and `If-Range`."""
    give_back = downloads.take(client.name)
    try:
        with _problems():
            path, release = await archive.borrow(segment, client=client.name)

        def over() -> None:
            release()
            give_back()

        try:
            return await run_in_threadpool(Download, path, f"{segment}.mcap", over)
        except BaseException:
            release()
            raise
    except BaseException:
        give_back()
        raise


@router.post("/archive/{segment}/play", status_code=201, responses={**NO_SUCH, **BUSY})
async def play(
    operation: Annotated[Operation, operates("play")],
    service: TheService,
    archive: TheArchive,
    recordings: TheRecordings,
    segment: Segment,
    body: Annotated[PlayBody | None, Body()] = None,
) -> PlayingAnswer:
    """Play a segment as a stream of its own. `/recordings/{id}/play` holds, moves and stops it, with its id."""
    operation.about = {"segment": segment}
    wanted = checked(body)
    with _problems(), recording_problems():
        known, sensor, name = None, wanted.sensor, operation.client.name
        if sensor is None:
            known = await archive.known(segment, name)
            sensor = known.commit.sensor
        request = play_request(service, operation, wanted, segment, sensor)
        playing = await recordings.play_file(segment, request, lambda: archive.borrow(segment, known, name))
    return PlayingAnswer.of(playing)


def _time(text: str | None, field: str) -> int | None:
    try:
        return None if text is None else time_ns(text)
    except SettingsError as error:
        raise SettingsError(str(error), field) from None


@contextmanager
def _problems() -> Iterator[None]:
    """Turns errors of an archive into problems."""
    try:
        yield
    except NoSegmentError as error:
        raise ProblemError(404, str(error), "unknown-segment") from None
    except AwayArchiveError as error:
        raise ProblemError(503, str(error), "archive-away", {"Retry-After": "10"}) from None
    except BusyArchiveError as error:
        raise ProblemError(503, str(error), "archive-busy", {"Retry-After": "2"}) from None
    except DamagedArchiveError as error:
        raise ProblemError(507, str(error), "archive-damaged") from None
    except FullError as error:
        raise ProblemError(507, str(error), "storage") from None
