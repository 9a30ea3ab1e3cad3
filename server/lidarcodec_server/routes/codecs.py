"""`/api/v1/codecs`: the codecs that a stream can use."""

from __future__ import annotations

from functools import cache
from typing import Annotated

from fastapi import APIRouter, Path, Response
from pydantic import TypeAdapter

from lidarcodec.codecs import table
from lidarcodec.codecs.base import Codec
from lidarcodec.codecs.other_sensors import KINDS
from lidarcodec.network.shelf import shipped
from lidarcodec.ratecontrol.curve import RETURNS_A_SECOND, Pins, has_curve, operating_curve
from lidarcodec_server.auth import Viewer
from lidarcodec_server.problems import ProblemError
from lidarcodec_server.schemas import CodecAnswer, Reach

router = APIRouter(prefix="/api/v1/codecs", tags=["codecs"])

FOR_EVER = {"Cache-Control": "private, max-age=31536000, immutable"}
"""The name of weights is their hash, so they never change."""


@router.get("", response_model=list[CodecAnswer])
def codecs(client: Viewer) -> Response:
    """The codecs, with the JSON schemas of their settings, their guarantees and the bitrates that they reach."""
    return Response(_all(), media_type="application/json")


@router.get(
    "/riddle/weights/{name}",
    response_class=Response,
    responses={
        200: {"content": {"application/octet-stream": {}}, "description": "The file."},
        404: {"description": "This version has no such weights."},
    },
)
def riddle_weights(
    client: Viewer,
    name: Annotated[str, Path(pattern=r"^[0-9a-f]{16}$", description="The name that is used in messages.")],
) -> Response:
    """A weight file of the codec `riddle` from the package, for programs that decode messages themselves."""
    found = shipped().get(name)
    if found is None:
        raise ProblemError(
            404, f"this server does not have the weights {name}: they arrive with the stream that uses them", "weights"
        )
    return Response(found.data, media_type="application/octet-stream", headers=FOR_EVER)


@cache
def _all() -> bytes:
    """The answer. It is the same for all clients and slow to write, so it is written once."""
    return TypeAdapter(list[CodecAnswer]).dump_json([_answer(name) for name in table.names()])


@cache
def _answer(name: str) -> CodecAnswer:
    codec = table.codec(name)
    return CodecAnswer(
        name=name,
        bound=codec.bounded,
        target=codec.knob is not None,
        clouds=name in KINDS,
        settings_schema=codec.settings.model_json_schema(),
        reach=_reach(name, codec),
    )


def _reach(name: str, codec: Codec) -> Reach | None:
    if codec.knob is None or not has_curve(name):
        return None
    curve = operating_curve(name, Pins())
    low, high = float(curve.range[0]), float(curve.range[-1])
    return Reach(
        setting=codec.knob.setting,
        coarsest=curve.points[0].value,
        finest=curve.points[-1].value,
        range_bits_per_return=(round(low, 3), round(high, 3)),
        range_kbps=(round(low * RETURNS_A_SECOND / 1e3, 1), round(high * RETURNS_A_SECOND / 1e3, 1)),
        kbps=(
            round(float(curve.bits[0]) * RETURNS_A_SECOND / 1e3, 1),
            round(float(curve.bits[-1]) * RETURNS_A_SECOND / 1e3, 1),
        ),
    )
