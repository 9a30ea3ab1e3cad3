"""`/api/v1/fleet`: all streams, one row each, for a list that is updated once a second."""

from __future__ import annotations

import time
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from lidarcodec_server.auth import Viewer
from lidarcodec_server.fleet.fleet import Stream, number_in
from lidarcodec_server.routes.common import TheService
from lidarcodec_server.routes.live import TheRecordings

router = APIRouter(prefix="/api/v1", tags=["streams"])


class FleetRow(BaseModel):
    """A stream in a row. Values are null if the vehicle did not report them.

    If the server has no room for any stream of a vehicle, the vehicle has one row, with the name of one of its streams
    and `room` false.
    """

    vehicle: str
    sensor: str
    alive: bool
    ended: bool = Field(description="Whether the source of the vehicle has ended.")
    silent_s: float | None = Field(description="Seconds since the last status; null before the first one.")
    codec: str | None
    reduction: str | None
    kbps: float | None = Field(description="Sent bitrate over the last five seconds.")
    fps: float | None
    target: float | Literal["auto"] | None = Field(description="The target bitrate of the settings.")
    target_kbps: float | None = Field(description="The bitrate that is aimed at now.")
    reached: bool | None = Field(description="Whether the target is kept; null without a target.")
    latency_ms: float | None = Field(
        description="Median time from the last packet of a frame to the decoded frame, at the receiver that "
        "controls the stream."
    )
    replaced: int | None = Field(description="Frames replaced by newer ones, since the vehicle started.")
    left_out: int = Field(
        description="Streams of this vehicle above the server's limit. It remembers up to `--max-sensors` of them."
    )
    room: bool = Field(
        description="Whether the server has room for this stream. Without room it knows nothing else of it."
    )
    recording: str | None = Field(description="Id of the current recording.")
    playback: str | None = Field(description="Id of the recording that is played as this stream.")
    minute: list[float | None] | None = Field(
        description="With `minute=true`: `kbps` of the last minute, one a second, oldest first."
    )


@router.get("/fleet")
def fleet(
    service: TheService,
    recordings: TheRecordings,
    client: Viewer,
    minute: Annotated[bool, Query(description="Include the bitrates of the last minute.")] = False,
) -> list[FleetRow]:
    """All streams, one row each."""
    now_s = time.monotonic()
    recorded, played = recordings.names()
    waiting = service.fleet.waiting()
    streams = service.streams()
    known = {one.keys.vehicle for one in streams}
    outside = [Stream(of_it[0], alive=True) for vehicle, of_it in waiting.items() if vehicle not in known]
    return [
        _row(one, now_s, minute).model_copy(
            update={
                "left_out": len(waiting.get(one.keys.vehicle, ())),
                "room": one not in outside,
                "recording": recorded.get(one.keys),
                "playback": played.get(one.keys),
            }
        )
        for one in sorted([*streams, *outside], key=lambda one: (one.keys.vehicle, one.keys.sensor))
    ]


def _row(stream: Stream, now_s: float, minute: bool) -> FleetRow:
    """The row of a stream."""
    status: dict[str, Any] = stream.status or {}
    rate = status.get("rate") if isinstance(status.get("rate"), dict) else None
    replaced = number_in(status, "replaced")
    return FleetRow(
        vehicle=stream.keys.vehicle,
        sensor=stream.keys.sensor,
        alive=stream.alive,
        ended=status.get("ended") is True,
        silent_s=None if stream.status is None else round(max(0.0, now_s - stream.status_s), 1),
        codec=stream.codec,
        reduction=None if stream.settings is None else stream.settings.reduction,
        kbps=number_in(status, "kbps") if stream.alive else None,
        fps=number_in(status, "fps") if stream.alive else None,
        target=None if stream.settings is None else stream.settings.target_kbps,
        target_kbps=number_in(rate, "target_kbps"),
        reached=None if rate is None or not isinstance(rate.get("reached"), bool) else rate["reached"],
        latency_ms=_latency_ms(status) if stream.alive else None,
        replaced=None if replaced is None else int(replaced),
        left_out=0,
        room=True,
        recording=None,
        playback=None,
        minute=list(stream.kbps) if minute else None,
    )


def _latency_ms(status: dict[str, Any]) -> float | None:
    """Latency at the receiver that controls the stream, otherwise at the first receiver that reports one."""
    reports = status.get("reports")
    if not isinstance(reports, dict):
        return None
    flight = status.get("flight")
    following = flight.get("following") if isinstance(flight, dict) else None
    first = [reports[following]] if isinstance(following, str) and following in reports else []
    told = (number_in(report, "latency_p50_ms") for report in [*first, *reports.values()])
    return next((value for value in told if value is not None), None)
