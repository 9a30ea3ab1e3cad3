"""One message in twenty is lost between publisher and receiver, by a program that subscribes and republishes."""

from __future__ import annotations

import time
from typing import Any

from lidarcodec.transport import Endpoints
from lidarcodec.transport.keys import StreamKeys
from tests.faults.between import Between
from tests.faults.outcome import Outcome, await_frames, ends, missing, outage_s
from tests.transport.conftest import free_port

LOSS = 0.05
SECONDS = 25.0


def run(seconds: float = SECONDS) -> Outcome:
    intra, video = _played({}, seconds), _played({"codec": "h264"}, seconds)
    return Outcome(
        f"{LOSS:.0%} of messages dropped by a relay that republishes",
        max(intra["outage s"], video["outage s"]),
        "the dropped ones, and what the publisher held back for 0.3 s after each, with h264 for a second: "
        f"{intra['missing']} of "
        f"{intra['indices']} frames with pcodec ({intra['dropped']} dropped), {video['missing']} of "
        f"{video['indices']} with h264 ({video['dropped']} dropped)",
        f"publisher: {intra['timeouts']} `timeouts` and {intra['unreported']} `unreported`; receiver: `missing` and "
        f"`gaps`; with h264 {video['missing_references']} `missing_references`, "
        "because a key frame follows a lost message",
        {"pcodec": intra, "h264": video},
        [f"errors: {one['errors']}" for one in (intra, video) if set(one["errors"]) - {"missing_references"}],
    )


def _played(settings: dict[str, Any], seconds: float) -> dict[str, Any]:
    near, far = f"tcp/127.0.0.1:{free_port()}", f"tcp/127.0.0.1:{free_port()}"
    with ends() as start:
        car = start("publish", listen=near, settings=settings)
        between = Between(StreamKeys(), Endpoints.of(connect=near), Endpoints.of(listen=far, mode="peer"), loss=LOSS)
        try:
            office = start("subscribe", connect=far)
            await_frames(office, 5)
            begin_s = time.monotonic()
            time.sleep(seconds)
            outage = outage_s(office, begin_s)
            status, dropped = car.status, between.dropped
            office.end()
        finally:
            between.close()
    summary = office.all("summary")[0]
    return {
        "outage s": outage,
        "dropped": dropped,
        "missing": missing(office.frames),
        "indices": office.frames[-1]["index"] - office.frames[0]["index"] + 1,
        "timeouts": status["flight"]["timeouts"],
        "unreported": status["flight"]["unreported"],
        "missing_references": summary["errors"].get("missing_references", 0),
        "errors": summary["errors"],
    }
