"""What vehicles kept: fetching clips of it, and marking spans so that they are not overwritten."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal, cast

from fastapi import APIRouter, Body, Depends, Path, Query, Response
from pydantic import BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request

from lidarcodec.apps.past.plan import Clip
from lidarcodec.apps.past.times import check_quality, span_of
from lidarcodec.errors import SourceError
from lidarcodec.recording.marks import Mark
from lidarcodec.settings import MAX_NAME, NAME_PATTERN
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError, read_object
from lidarcodec_server.auth import Viewer
from lidarcodec_server.fleet.answers import AwayError, RefusedError
from lidarcodec_server.live.download import MEDIA_TYPE, Download
from lidarcodec_server.operations import Operation, begun, operates
from lidarcodec_server.past.clips import Record, State
from lidarcodec_server.past.fetches import BusyClipError, Fetches, NoFetchError, TooManyFetchesError
from lidarcodec_server.past.marked import MAX_ANSWER
from lidarcodec_server.past.spans import Spans
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.routes.common import TheService, TheStream, known_stream, time_of
from lidarcodec_server.routes.live import TheDownloads, TheRecordings
from lidarcodec_server.routes.recordings import BUSY, PlayBody, PlayingAnswer, checked, play_request, recording_problems
from lidarcodec_server.service import Service

router = APIRouter(prefix="/api/v1", tags=["past"])

NO_SUCH: dict[int | str, dict[str, Any]] = {404: {"description": "No such stream, fetch or mark."}}
FULL: dict[int | str, dict[str, Any]] = {507: {"description": "The folder of clips is full or cannot be written."}}
READ: dict[int | str, dict[str, Any]] = {409: {"description": "Its clip is being played or downloaded."}}
Id = Annotated[str, Path(max_length=64, examples=["20261126T120000Z-3fa2c9"])]
Time = Annotated[str, Query(max_length=64, description="RFC 3339, or nanoseconds since 1970.")]
MarkName = Annotated[str, Path(pattern=f"^{NAME_PATTERN.pattern}$", max_length=MAX_NAME, examples=["crash-1"])]


class ProgressAnswer(BaseModel):
    """How far a fetch is. `waiting`: what it waits for, null while it receives. `gaps`: spans in ns that the vehicle
    did not keep."""

    listed: bool = Field(description="Whether the vehicle has told of all pieces.")
    pieces: int
    pieces_done: int
    bytes: int
    bytes_done: int
    bytes_received: int = Field(description="Received over the network since the server started.")
    frames: int
    gaps: list[tuple[int, int]]
    waiting: str | None


class FetchAnswer(BaseModel):
    """A fetch. Times of the clip are in ns since the Unix epoch."""

    id: str
    vehicle: str
    sensor: str
    from_ns: int
    to_ns: int
    state: State
    by: str = Field(description="Who asked for it.")
    started: datetime
    ended: datetime | None
    reason: str | None = Field(description="Why it failed.")
    size_bytes: int = Field(description="Of the clip, once it is complete.")
    clip: str | None = Field(description="Path of the clip, once it is complete.")
    gaps: list[tuple[int, int]] = Field(description="Of a complete clip: spans in ns that the vehicle did not keep.")
    missing_frames: int | None = Field(
        description="Of a complete clip: frames that are missing between its own, by their numbers. Null: not known."
    )
    playing: PlayingAnswer | None = Field(default=None, description="The playback of its clip; null without one.")
    progress: ProgressAnswer | None = Field(description="Null when it is over.")

    @classmethod
    def of(
        cls, record: Record, progress: dict[str, Any] | None = None, playing: dict[str, Any] | None = None
    ) -> FetchAnswer:
        """From a record. playing: the state of the playback of its clip"""
        clip, keys = record.clip, record.clip.keys
        here = f"/api/v1/streams/{keys.vehicle}/{keys.sensor}/past?from={clip.from_ns}&to={clip.to_ns}"
        return cls(
            id=record.id,
            vehicle=keys.vehicle,
            sensor=keys.sensor,
            from_ns=clip.from_ns,
            to_ns=clip.to_ns,
            state=record.state,
            by=record.by,
            started=time_of(record.started_ns),
            ended=None if record.ended_ns is None else time_of(record.ended_ns),
            reason=record.reason,
            size_bytes=record.size,
            clip=here if record.state == "complete" else None,
            gaps=list(record.gaps),
            missing_frames=record.missing,
            playing=None if playing is None else PlayingAnswer.of(playing),
            progress=None if progress is None else ProgressAnswer(**progress),
        )


class MarkBody(BaseModel):
    """A span to keep. Times are RFC 3339, or ns since 1970; it has ten minutes at most, and may end ahead."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    begin: str | int = Field(alias="from")
    end: str | int = Field(alias="to")
    reason: str = Field(default="", max_length=200)
    fetch: bool = Field(default=True, description="Fetch the clip, too.")


class MarkAnswer(BaseModel):
    """A mark on the vehicle, and the fetch of its clip."""

    name: str
    from_ns: int
    to_ns: int
    reason: str
    by: str
    fetch: FetchAnswer | None = None


class KeptAnswer(BaseModel):
    """What a vehicle keeps, and what is here. Spans are begin and end in ns since the Unix epoch."""

    vehicle: list[tuple[int, int]] | None = Field(
        description="As the vehicle told it last; null if it never did since the server started."
    )
    age_s: float | None = Field(description="How long ago the vehicle told that.")
    here: list[tuple[int, int]]
    marks: list[MarkAnswer]


def fetches_of(connection: HTTPConnection) -> Fetches:
    """The fetches of the app."""
    return cast(Fetches, connection.app.state.fetches)


def spans_of(connection: HTTPConnection) -> Spans:
    """What vehicles of the app keep."""
    return cast(Spans, connection.app.state.spans)


TheFetches = Annotated[Fetches, Depends(fetches_of)]


@router.get(
    "/streams/{vehicle}/{sensor}/past",
    response_model=FetchAnswer,
    responses={
        200: {"description": "The clip, a recording.", "content": {MEDIA_TYPE: {}}},
        202: {"model": FetchAnswer, "description": "It is being fetched; `Location` tells of that."},
        **NO_SUCH,
        **FULL,
    },
)
def past(
    request: Request,
    service: TheService,
    fetches: TheFetches,
    downloads: TheDownloads,
    recordings: TheRecordings,
    keys: TheStream,
    client: Viewer,
    begin: Annotated[Time, Query(alias="from")],
    end: Annotated[Time, Query(alias="to")],
    quality: Annotated[str, Query(max_length=16, description="Only `exact`.")] = "exact",
    wanted: Annotated[
        Literal["clip", "fetch"], Query(alias="as", description="`fetch`: of a clip that is here, tell its fetch only.")
    ] = "clip",
) -> Response:
    """A clip of what a vehicle kept, exactly. If it is not here yet, it is fetched in the background; only operators
    may begin that. The same request joins a fetch that runs."""
    check_quality(quality)
    known_stream(service, keys)
    clip = Clip(keys, *span_of(begin, end, now_ns=time.time_ns()))
    here = fetches.here(clip)
    if here is not None and wanted == "fetch":
        told = FetchAnswer.of(here, None, recordings.playing(here.id))
        return Response(told.model_dump_json(), media_type="application/json")
    if here is not None:
        return _download(fetches, here, downloads.take(client.name))
    record = fetches.running(clip)
    if record is None:
        operation = begun(request, "fetch")
        operation.about = {"from_ns": clip.from_ns, "to_ns": clip.to_ns}
        record = _begin(fetches, clip, operation.client.name)
        operation.about |= {"fetch": record.id}
    answer = FetchAnswer.of(*fetches.state(record.id))
    return Response(
        answer.model_dump_json(), 202, {"Location": f"/api/v1/fetches/{record.id}"}, media_type="application/json"
    )


@router.get("/streams/{vehicle}/{sensor}/past/spans", responses=NO_SUCH)
def spans(
    service: TheService,
    fetches: TheFetches,
    asked: Annotated[Spans, Depends(spans_of)],
    keys: TheStream,
    client: Viewer,
) -> KeptAnswer:
    """Which times the vehicle keeps, which are here, and what is marked. The server asks the vehicle. If many clients
    ask, or the vehicle does not answer, the answer has what it told last."""
    told = asked.told(keys, alive=known_stream(service, keys).alive)
    done = [one for one in fetches.all() if one.state == "complete" and one.clip.keys == keys]
    marks = [] if told is None else told.marks
    return KeptAnswer(
        vehicle=None if told is None else told.spans,
        age_s=None if told is None else round(time.monotonic() - told.at_s, 3),
        here=sorted(span for one in done for span in one.spans())[-64:],
        marks=[
            MarkAnswer(name=one.name, from_ns=one.from_ns, to_ns=one.to_ns, reason=one.reason, by=one.by)
            for one in marks
        ],
    )


@router.put("/streams/{vehicle}/{sensor}/marks/{mark}", responses={**NO_SUCH, **FULL})
def set_mark(
    service: TheService,
    fetches: TheFetches,
    keys: TheStream,
    mark: MarkName,
    body: MarkBody,
    operation: Annotated[Operation, operates("mark")],
) -> MarkAnswer:
    """Keep a span on the vehicle from being overwritten, and fetch it."""
    known_stream(service, keys)
    clip = Clip(keys, *span_of(body.begin, body.end, now_ns=time.time_ns()))
    wanted = Mark(mark, clip.from_ns, clip.to_ns, body.reason, operation.client.name[:64], time.time_ns())
    operation.about |= {"mark": mark, "from_ns": clip.from_ns, "to_ns": clip.to_ns}
    question = {"name": mark, "from": wanted.from_ns, "to": wanted.to_ns, "reason": wanted.reason, "by": wanted.by}
    with service.limits.slot(operation.client.name, keys):
        _told(_ask(service, keys.past_mark, question), keys)
    answer = MarkAnswer(name=mark, from_ns=wanted.from_ns, to_ns=wanted.to_ns, reason=wanted.reason, by=wanted.by)
    if body.fetch:
        kept = None if fetches.here(clip) is None else fetches.keep(clip)
        answer.fetch = FetchAnswer.of(kept or _begin(fetches, clip, operation.client.name, stays=True))
    return answer


@router.delete("/streams/{vehicle}/{sensor}/marks/{mark}", status_code=204, responses=NO_SUCH)
def release_mark(
    service: TheService, keys: TheStream, mark: MarkName, operation: Annotated[Operation, operates("mark-release")]
) -> None:
    """Release a mark: what it covers may be overwritten again on the vehicle."""
    known_stream(service, keys)
    operation.about |= {"mark": mark}
    with service.limits.slot(operation.client.name, keys):
        told = _told(_ask(service, keys.past_mark, {"release": mark}), keys)
    if told.get("released") is not True:
        raise ProblemError(404, f"{keys.vehicle}/{keys.sensor} has no mark {mark}", "unknown-mark")


@router.get("/fetches", responses=FULL)
def all_fetches(
    fetches: TheFetches,
    recordings: TheRecordings,
    client: Viewer,
    vehicle: Annotated[str | None, Query(max_length=MAX_NAME, description="Only those of this vehicle.")] = None,
    sensor: Annotated[str | None, Query(max_length=MAX_NAME, description="Only those of this sensor.")] = None,
    state: Annotated[list[State] | None, Query(max_length=4, description="Only those in these states.")] = None,
    limit: Annotated[
        int | None, Query(ge=0, le=10_000, description="Most that are over. Those that run are listed anyway.")
    ] = None,
) -> list[FetchAnswer]:
    """Fetches, newest first, without their progress."""
    found = [
        one
        for one in fetches.all()
        if vehicle in (None, one.clip.keys.vehicle)
        and sensor in (None, one.clip.keys.sensor)
        and (state is None or one.state in state)
    ]
    if limit is not None:
        over = {one.id for one in [one for one in found if one.state != "running"][limit:]}
        found = [one for one in found if one.id not in over]
    return [FetchAnswer.of(one, None, recordings.playing(one.id)) for one in found]


@router.get("/fetches/{id}", responses=NO_SUCH)
def one_fetch(fetches: TheFetches, recordings: TheRecordings, id: Id, client: Viewer) -> FetchAnswer:
    """One fetch, and its progress."""
    record, progress = _state(fetches, id)
    return FetchAnswer.of(record, progress, recordings.playing(id))


@router.post("/fetches/{id}/play", status_code=201, responses={**NO_SUCH, **BUSY})
async def play(
    service: TheService,
    fetches: TheFetches,
    recordings: TheRecordings,
    id: Id,
    operation: Annotated[Operation, operates("play")],
    body: Annotated[PlayBody | None, Body()] = None,
) -> PlayingAnswer:
    """Play a fetched clip as a stream of its own. `/recordings/{id}/play` holds, moves and stops it, with its id."""
    operation.about = {"fetch": id[:64]}
    wanted = checked(body)
    record, _ = _state(fetches, id)

    async def borrow() -> tuple[FilePath, Callable[[], None]]:
        return await run_in_threadpool(fetches.borrow, record)

    try:
        with recording_problems():
            request = play_request(service, operation, wanted, id, record.clip.keys.sensor)
            return PlayingAnswer.of(await recordings.play_file(id, request, borrow))
    except NoFetchError as error:
        raise ProblemError(404, str(error), "unknown-fetch") from None


@router.delete("/fetches/{id}", responses={**NO_SUCH, **READ, **FULL})
def cancel(fetches: TheFetches, id: Id, operation: Annotated[Operation, operates("fetch-cancel")]) -> FetchAnswer:
    """Cancel a fetch. If it is complete, delete its clip, unless that is being played or downloaded."""
    operation.about = {"fetch": id[:64]}
    try:
        record = fetches.cancel(id)
    except NoFetchError as error:
        raise ProblemError(404, str(error), "unknown-fetch") from None
    except BusyClipError as error:
        raise ProblemError(409, str(error), "busy") from None
    operation.keys = record.clip.keys
    return FetchAnswer.of(record)


def _state(fetches: Fetches, name: str) -> tuple[Record, dict[str, Any] | None]:
    """A fetch and its progress. Raises ProblemError 404."""
    try:
        return fetches.state(name)
    except NoFetchError as error:
        raise ProblemError(404, str(error), "unknown-fetch") from None


def _download(fetches: Fetches, record: Record, ended: Callable[[], object]) -> Download:
    """The clip of a fetch. ended: called once, also if this raises ProblemError 404"""
    try:
        path, give_back = fetches.borrow(record)
    except NoFetchError as error:
        ended()
        raise ProblemError(404, str(error), "unknown-fetch") from None

    def over() -> None:
        give_back()
        ended()

    try:
        return Download(path, _file_name(record.clip), over)
    except BaseException:
        over()
        raise


def _begin(fetches: Fetches, clip: Clip, by: str, *, stays: bool = False) -> Record:
    try:
        return fetches.begin(clip, by, stays=stays)
    except TooManyFetchesError as error:
        raise ProblemError(429, str(error), "too-many", {"Retry-After": "60"}) from None
    except SourceError as error:
        raise ProblemError(507, str(error), "storage") from None


def _ask(service: Service, key: str, question: dict[str, Any]) -> dict[str, Any] | None:
    """A vehicle's answer; None if there is none that can be read."""
    data = service.transport.ask(key, json.dumps(question).encode(), service.config.answer_s)
    try:
        return None if data is None else read_object(data, MAX_ANSWER)
    except JsonRefusedError:
        return None


def _told(told: dict[str, Any] | None, keys: StreamKeys) -> dict[str, Any]:
    """The answer itself. Raises AwayError, RefusedError."""
    if told is None:
        raise AwayError(f"{keys.vehicle}/{keys.sensor} is not connected, or does not keep data (publish --keep)")
    if "error" in told:
        raise RefusedError(str(told["error"])[:500], str(told.get("field") or "mark")[:100])
    return told


def _file_name(clip: Clip) -> str:
    return f"{clip.keys.vehicle}_{clip.keys.sensor}_{time_of(clip.from_ns):%Y%m%dT%H%M%SZ}.mcap"
