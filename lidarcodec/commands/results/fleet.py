"""JSON of `token`, `certs` and `train`."""

from __future__ import annotations

from typing import Annotated, Any

from typing_extensions import TypedDict


class TokenCreated(TypedDict):
    """Of `token create`. The token is shown only this once."""

    name: Annotated[str, "name of the token"]
    role: Annotated[str, "`viewer` or `operator`"]
    token: Annotated[str, "the token itself"]


class TokenAbout(TypedDict):
    """One token of `token list`."""

    name: Annotated[str, "name of the token"]
    role: Annotated[str, "`viewer` or `operator`"]
    created: Annotated[str, "when it was created (ISO 8601, UTC)"]
    revoked: Annotated[str | None, "when it was revoked; null if it is valid"]


class TokenRevoked(TypedDict):
    """Of `token revoke`."""

    name: Annotated[str, "name of the revoked token"]


class Certified(TypedDict):
    """Of `certs`."""

    folder: Annotated[str, "folder of the deployment"]
    written: Annotated[list[str], "paths of the files written"]
    notes: Annotated[list[str], "what to know or to do, a sentence each"]


class Trained(TypedDict):
    """Of `train riddle`."""

    output: Annotated[str, "path of the weight file"]
    bytes: Annotated[int, "its size"]
    weights: Annotated[str, "name of the weights"]
    networks: Annotated[list[dict[str, Any]], "what the file says about each network"]


class TrainedScores(TypedDict):
    """Of `train poconet` and `train scores`."""

    outputs: Annotated[list[str], "paths of the files written"]
    steps: Annotated[int, "training steps"]
    seconds: Annotated[float, "time spent on training, over all runs"]
    tests: Annotated[dict[str, Any], "results on each drive of `--test`"]
