"""A part of the past is fetched exactly over the link of the live stream, through cuts and restarts of both ends.

    python -m tests.faults.past_fetched

is the long form: ten minutes of driving, of which the middle one is fetched.
"""

from __future__ import annotations

import json
import signal
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Self

from tests.apps.relay import Relay
from tests.apps.test_processes import End
from tests.conftest import data_folder
from tests.faults.outcome import Outcome, await_frames, ends, outage_s
from tests.faults.past_vehicle import Vehicle, to_and_fro
from tests.faults.serving import Server
from tests.packets import packets_in
from tests.transport.conftest import free_port
from tests.transport.router import Router

DRIVE = "kitti_0005.pcap.xz"
STREAM = "/api/v1/streams/vehicle/lidar"
KBIT, LIVE_KBPS = 4_000.0, 2_000.0
ALONE_S, CLIP_S, CUT_S = 40.0, 15.0, 5.0
LONG_CLIP_S, LONG_ALONE_S, LONG_S = 60.0, 335.0, 600.0
"""Of the long form: the clip, what was driven when it is asked for, and the whole drive."""
LIMIT_S = 1500.0
MOST_BYTES = 1.05
"""What may be received, in times of the clip."""
SETTLED_S = 6.0
"""Latency is not counted from a fault until so long after it."""
MAX_LATER_MS = 10.0


class Drill:
    """Vehicle, slow link, router, server and a live viewer. A context manager."""

    def __init__(self, folder: Path, start: Callable[..., End]) -> None:
        port, near = free_port(), free_port()
        self.options: dict[str, Any] = {
            "source": str(data_folder() / DRIVE),
            "keep": str(folder / "ring"),
            "settings": {"target_kbps": LIVE_KBPS},
            "listen": f"tcp/127.0.0.1:{port}",
        }
        self.car = Vehicle(**self.options)
        self.relay = Relay(port, kbit=KBIT)
        here = f"tcp/127.0.0.1:{near}"
        self.router = Router(listen=here, connect=f"tcp/127.0.0.1:{self.relay.port}")
        past = str(folder / "past")
        self.server = Server(folder, free_port(), free_port(), LIDARCODEC_CONNECT=here, LIDARCODEC_SERVE_PAST=past)
        self.office = start("subscribe", connect=here)
        self.received: list[int] = [0]  # by each server, one after the other
        self.clip_bytes = self.left_bytes = 0

    def __enter__(self) -> Self:
        self.server.start()
        await_frames(self.office, 50)
        return self

    def __exit__(self, *exc: object) -> None:
        self.server.kill()
        self.router.kill()
        self.relay.close()
        self.car.process.kill()

    def cut(self) -> None:
        """Nothing passes the link for a while."""
        self.relay.kbit = 0.0
        time.sleep(CUT_S)
        self.relay.kbit = KBIT

    def restart_vehicle(self) -> None:
        """Kill the vehicle, and start it again."""
        self.car.end(signal.SIGKILL)
        self.car = Vehicle(**self.options)
        await_frames(self.office, 5)

    def restart_server(self) -> None:
        """Kill the server, and start it again."""
        self.server.kill()
        self.received.append(0)
        self.server.start()

    def progress(self, name: str) -> dict[str, Any] | None:
        """How far a fetch is; None if it is over."""
        _, told = self.server.ask(f"/api/v1/fetches/{name}")
        if not isinstance(told, dict):
            return {"listed": False}
        now: dict[str, Any] | None = told["progress"]
        if now is not None and now["listed"]:
            self.received[-1] = now["bytes_received"]
            self.clip_bytes, self.left_bytes = now["bytes"], now["bytes"] - now["bytes_done"]
        return now

    def latency_ms(self, begin_s: float, end_s: float, without: Sequence[tuple[float, float]] = ()) -> float:
        """Live latency at the 95th percentile, between two times of the monotonic clock."""
        latencies = sorted(
            one["latency_ms"]
            for one in self.office.frames
            if begin_s < one["at_s"] < end_s and not any(begin <= one["at_s"] <= end for begin, end in without)
        )
        return float(latencies[int(0.95 * (len(latencies) - 1))])


def run(clip_s: float = CLIP_S, alone_s: float = ALONE_S, whole_s: float = 0.0) -> Outcome:
    """clip_s: length of the clip;  alone_s: drive before it is asked for;  whole_s: the drive lasts at least so long"""
    with tempfile.TemporaryDirectory() as folder, ends() as start, Drill(Path(folder), start) as drill:
        begin_s = time.monotonic()
        time.sleep(max(alone_s, clip_s + 10.0))
        to_ns, fetch_s = time.time_ns() - 5 * 10**9, time.monotonic()
        where = f"{STREAM}/past?from={to_ns - int(clip_s * 1e9)}&to={to_ns}"
        status, told = drill.server.ask(where)
        name = told["id"]
        faults: list[tuple[float, float]] = []
        plan = ((0.15, drill.cut), (0.35, drill.restart_vehicle), (0.55, drill.restart_server), (0.75, drill.cut))
        for share, fault in plan:
            await_share(drill, name, share)
            fault_s = time.monotonic()
            fault()
            faults.append((fault_s, time.monotonic() + SETTLED_S))
        await_share(drill, name, 1.0)
        done_s = time.monotonic()
        done = drill.server.ask(f"/api/v1/fetches/{name}")[1]
        clip = Path(folder) / "clip.mcap"
        with urllib.request.urlopen(drill.server.url + where, timeout=60) as answer:
            clip.write_bytes(answer.read())
        time.sleep(max(0.0, begin_s + whole_s - time.monotonic()))
        alone = drill.latency_ms(begin_s, time.monotonic(), [(fetch_s, done_s + SETTLED_S)])
        beside = drill.latency_ms(fetch_s, done_s, faults)
        outage = outage_s(drill.office, fetch_s, done_s)
        identical, packets, spanned_s = compared(clip, drill.options["source"])
        more = (sum(drill.received) + drill.left_bytes) / drill.clip_bytes
    wrong = [] if status == 202 else [f"the first request was answered with {status}"]
    wrong += [] if done["state"] == "complete" else [f"the fetch: {done['state']}, {done['reason']}"]
    wrong += [] if identical and spanned_s >= clip_s else ["the packets of the clip are not those of the drive"]
    wrong += [] if beside <= alone + MAX_LATER_MS else [f"live p95 {beside:.0f} ms beside the fetch, {alone:.0f} alone"]
    wrong += [] if more <= MOST_BYTES else [f"{more:.3f} times the bytes of the clip were received"]
    return Outcome(
        f"{clip_s:g} s of the past fetched over the {KBIT / 1e3:g} Mbit/s link of a live stream of {LIVE_KBPS / 1e3:g} "
        "Mbit/s; link cut twice, vehicle and server killed",
        outage,
        f"nothing of the clip: {packets} packets identical",
        f"server: complete after {done_s - fetch_s:.0f} s, {more:.3f} times its bytes received; live latency at the "
        f"95th percentile {alone:.0f} ms alone, {beside:.0f} ms beside the fetch",
        {"clip_bytes": done["size_bytes"]},
        wrong,
    )


def await_share(drill: Drill, name: str, share: float) -> None:
    """Wait until so much of a fetch is done.

    Raises TimeoutError when it takes too long.
    """
    end_s = time.monotonic() + LIMIT_S
    while time.monotonic() < end_s:
        progress = drill.progress(name)
        if progress is None:  # it is over
            return
        if progress["listed"] and progress["bytes_done"] >= share * progress["bytes"] and share < 1.0:
            return
        time.sleep(0.2)
    raise TimeoutError(f"{share:.0%} of the clip did not come in {LIMIT_S:g} s")


def compared(clip: Path, drive: str) -> tuple[bool, int, float]:
    """Whether the packets of a clip are a part of a drive to and fro, how many there are, and the seconds they span."""
    found = packets_in(clip)
    want = [packet.payload for packet in to_and_fro(drive).packets()]
    starts = [number for number, payload in enumerate(want) if payload == found[0].payload]
    same = any(
        all(packet.payload == want[(begin + number) % len(want)] for number, packet in enumerate(found))
        for begin in starts
    )
    return same, len(found), (found[-1].stamp_ns - found[0].stamp_ns) / 1e9 + 0.2


def main() -> int:
    outcome = run(LONG_CLIP_S, LONG_ALONE_S, LONG_S)
    print(json.dumps(outcome.as_json()), flush=True)
    return int(bool(outcome.wrong))


if __name__ == "__main__":
    sys.exit(main())
