"""Streams through a program that harms their messages, and what came of it: for the rows of lossy links.

    python -m tests.faults.harmed CODEC[,CODEC] [loss=0.05] [delay_s=0.05] ...

prints the figures of one harm, for work on them.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.keys import StreamKeys
from tests.faults.between import Between, Harm
from tests.faults.outcome import Outcome, await_frames, ends, missing, outage_s
from tests.transport.conftest import free_port

CODECS = ("pcodec", "predictive", "riddle", "h264")
LOST_TIMES = {"pcodec": 1.2, "predictive": 1.5, "riddle": 1.5, "h264": 3.0}
"""Most frames that may be lost for each message that is lost or late."""
CHANCE = 2
"""Frames more that may be lost, because few messages are."""
RATES = {"riddle": 5.0}
"""Frames a second of a codec, if two cores do not carry both ends at 10: frames would be missing without harm."""
WHOLE, HARMED = 50, 120
"""Frames without harm, then with it."""


def played(codec: str, harm: Harm) -> dict[str, Any]:
    """Figures of a stream without harm (but for delays), then with it."""
    rate = RATES.get(codec, 10.0)
    near, far = f"tcp/127.0.0.1:{free_port()}", f"tcp/127.0.0.1:{free_port()}"
    with ends() as start:
        car = start("publish", listen=near, rate=rate, settings={"codec": codec})
        here, there = Endpoints.of(connect=near), Endpoints.of(listen=far, mode="peer")
        between = Between(StreamKeys(), open_transport(here), open_transport(there), harm)
        try:
            office = start("subscribe", connect=far)
            await_frames(office, 20)
            whole_from_s = time.monotonic()
            time.sleep(WHOLE / rate)
            before = car.status
            between.begin()
            begin_s = time.monotonic()
            time.sleep(HARMED / rate)
            end_s = time.monotonic()
            between.end()
            await_frames(office, 5)
            status = car.status
            office.end()
        finally:
            between.close()
    whole = [frame for frame in office.frames if whole_from_s < frame["at_s"] <= begin_s]
    harmed = [frame for frame in office.frames if begin_s - 0.5 < frame["at_s"] < end_s + 1.0]
    return {
        "outage s": outage_s(office, begin_s, end_s + 1.0),
        "outage s without harm": outage_s(office, whole_from_s, begin_s),
        "dropped": between.dropped,
        "late": between.late,
        "missing": missing(harmed),
        "indices": harmed[-1]["index"] - harmed[0]["index"] + 1,
        "missing without harm": missing(whole),
        "latency p95 ms": _p95_ms([frame for frame in harmed if begin_s < frame["at_s"] <= end_s]),
        "latency p95 ms without harm": _p95_ms(whole),
        "replaced": status["replaced"] - before["replaced"],
        "timeouts": status["flight"]["timeouts"] - before["flight"]["timeouts"],
        "unreported": status["flight"]["unreported"] - before["flight"]["unreported"],
        "key frames": status["key_frames"] - before["key_frames"],
        "errors": office.all("summary")[0]["errors"],
    }


def harmed(fault: str, harm: Harm, reported: str) -> Outcome:
    """The row of a harm, with all codecs."""
    return outcome(fault, {codec: played(codec, harm) for codec in CODECS}, reported)


def outcome(fault: str, figures: dict[str, dict[str, Any]], reported: str) -> Outcome:
    """The row of these figures."""
    lost = ", ".join(
        f"{codec} {one['missing']} of {one['indices']} ({one['dropped'] + one['late']}; {slow(one):.0f})"
        for codec, one in figures.items()
    )
    latency = ", ".join(
        f"{one['latency p95 ms']:.0f} ({one['latency p95 ms without harm']:.0f})" for one in figures.values()
    )
    return Outcome(
        fault,
        max(one["outage s"] for one in figures.values()),
        lost,
        f"{reported}; latency at the 95th percentile (without harm): {latency} ms",
        figures,
        [text for codec, one in figures.items() for text in wrong(codec, one)],
    )


def wrong(codec: str, figures: dict[str, Any]) -> list[str]:
    """What is worse than a lost message may cost. A machine that is too slow for a codec loses frames without harm."""
    most = LOST_TIMES[codec] * (figures["dropped"] + figures["late"]) + slow(figures) + CHANCE
    found = [f"{codec}: {figures['missing']} frames lost, {most:.0f} may be"] if figures["missing"] > most else []
    unknown = set(figures["errors"]) - {"missing_references"}
    return found + ([f"{codec}: errors {figures['errors']}"] if unknown else [])


def slow(figures: dict[str, Any]) -> float:
    """Frames that are lost in that time without harm."""
    return float(figures["missing without harm"]) * figures["indices"] / WHOLE


def _p95_ms(frames: list[dict[str, Any]]) -> float:
    latencies = sorted(frame["latency_ms"] for frame in frames)
    return round(latencies[int(0.95 * (len(latencies) - 1))], 1)


def main() -> None:
    given = {name: float(value) for name, value in (one.split("=") for one in sys.argv[2:])}
    for codec in sys.argv[1].split(","):
        one = played(codec, Harm(**given))
        print(json.dumps({"codec": codec, **given, **one}), flush=True)


if __name__ == "__main__":
    main()
