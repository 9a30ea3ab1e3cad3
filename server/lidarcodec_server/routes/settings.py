"""`/api/v1/streams/{vehicle}/{sensor}/settings` and `/keyframe`: changes of a running stream by operators."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from starlette.concurrency import run_in_threadpool

from lidarcodec.apps.control import settings_with
from lidarcodec.ratecontrol.reach import reach_warning
from lidarcodec.settings import StreamSettings
from lidarcodec_server.auth import Viewer
from lidarcodec_server.fleet.answers import State
from lidarcodec_server.operations import Operation, operates
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.routes.common import JsonObject, TheService, TheStream, known_stream
from lidarcodec_server.schemas import ChangeAnswer, KeyFrameAnswer, SettingsAnswer

router = APIRouter(prefix="/api/v1/streams/{vehicle}/{sensor}", tags=["settings"])


def change_schema() -> dict[str, Any]:
    """JSON schema of some StreamSettings: every field may be left out, but at least one is needed."""
    schema = StreamSettings.model_json_schema()
    fields = {name: {k: v for k, v in about.items() if k != "default"} for name, about in schema["properties"].items()}
    return {
        "type": "object",
        "title": "StreamSettingsChange",
        "description": "Some of the settings (docs/settings.md). A new `codec` starts with its own default settings.",
        "properties": fields,
        "additionalProperties": False,
        "minProperties": 1,
    }


CHANGE = {"requestBody": {"required": True, "content": {"application/json": {"schema": change_schema()}}}}


@router.get("/settings")
def settings(service: TheService, keys: TheStream, client: Viewer) -> SettingsAnswer:
    """The settings in force, and those that operators want. The server asks the vehicle. If many clients ask, or the
    vehicle does not answer, the answer has the settings that it reported last."""
    known_stream(service, keys)
    with service.limits.look(keys) as may_ask:
        return SettingsAnswer.of(service.control.state(keys, ask=may_ask))


@router.patch(
    "/settings",
    openapi_extra=CHANGE,
    responses={
        404: {"description": "A stream that was never seen. `prepare` stores settings for it."},
        202: {"model": ChangeAnswer, "description": "Stored: the vehicle is away and gets the change when it returns."},
    },
)
async def change(
    service: TheService,
    keys: TheStream,
    operation: Annotated[Operation, operates("settings")],
    changes: JsonObject,
    response: Response,
    strict: Annotated[bool, Query(description="Refuse a target bitrate that is out of reach, with 422.")] = False,
    prepare: Annotated[
        bool, Query(description="Also for a stream that was never seen; without it that is 404.")
    ] = False,
) -> ChangeAnswer:
    """Change some settings between two frames: either all of the given ones or none. Settings that are set here
    override the vehicle's command line."""

    def work() -> State:
        if not prepare:
            known_stream(service, keys, "check the name, or add ?prepare=true for a vehicle that is yet to come")
        with service.limits.slot(operation.client.name, keys):
            if strict:
                _check_reach(service.control.state(keys), changes)
            return service.control.change(keys, changes, operation.client.name, operation.entered)

    state = await run_in_threadpool(work)
    if state.applied is None:
        response.status_code = 202
    return ChangeAnswer.of(state)


def _check_reach(state: State, changes: dict[str, Any]) -> None:
    """Raise ProblemError if settings with these changes have a target bitrate that is out of reach."""
    before = state.applied or StreamSettings.model_validate(state.desired or {})
    warning = reach_warning(settings_with(before, changes), state.images)
    if warning is not None:
        raise ProblemError(422, f"{warning.message}: {warning.remedy}", warning.code, field="target_kbps")


@router.delete("/settings")
def forget(service: TheService, keys: TheStream, operation: Annotated[Operation, operates("forget")]) -> SettingsAnswer:
    """Delete the settings that operators set. The vehicle returns to those of its command line, from `first_frame` on;
    if it is away, as soon as it is back."""
    known_stream(service, keys)
    with service.limits.slot(operation.client.name, keys):
        state = service.control.forget(keys, operation.client.name, operation.entered)
    operation.first_frame = state.first_frame
    return SettingsAnswer.of(state)


@router.post("/keyframe")
def keyframe(
    service: TheService, keys: TheStream, operation: Annotated[Operation, operates("keyframe")]
) -> KeyFrameAnswer:
    """Make the next message a key frame. Requests within half a second are merged into one."""
    known_stream(service, keys)
    with service.limits.slot(operation.client.name, keys):
        answer = KeyFrameAnswer(**service.control.key_frame(keys))
    operation.first_frame = answer.first_frame
    return answer
