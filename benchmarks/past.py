"""A fetch of the past beside a live stream, over a slow link: what it takes of the link, and what that delays.

    python -m benchmarks.past [--seconds 20] [--rounds 2] [--round-trip-ms 0] [--round-trip-ms 50] [--save]

Drive KITTI 0005 with a target of 2 Mbit/s over a relay of 4 Mbit/s on loopback; vehicle and receiver are processes. For
--seconds the stream goes alone, then beside a fetch, and so on by turns; the first seconds of each part do not count.
The delay is the time from put to arrival report of live messages. --save writes benchmarks/results/past.csv, from which
`make evidence` writes the table.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, Final, NamedTuple

import lidarcodec
from benchmarks import results
from benchmarks.adaptive import End, percentile
from benchmarks.link_ends import KEYS
from benchmarks.links import Relayed
from benchmarks.scenes import DATA
from lidarcodec.apps.past.fetch import CancelledError, Fetch
from lidarcodec.apps.past.plan import Clip
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.transport import Endpoints, Transport, open_transport
from lidarcodec.transport.endpoints import free_port

KBIT, LIVE_KBPS = 4_000.0, 2_000.0
KEPT_S, CLIP_S, WARM_UP_S = 25.0, 15.0, 3.0
TITLE: Final = "A fetch beside a live stream"
ABOUT: Final = (
    "KITTI 0005, `pcodec` with a target of 2 Mbit/s, over 4 Mbit/s. Delay from put to arrival report of live messages."
)
HEAD: Final = (
    "| round trip | alone, p50 / p95 ms | beside a fetch, p50 / p95 ms | fetched, kbit/s | link used, alone, beside |\n"
    "|---|---|---|---|---|"
)


class Part(NamedTuple):
    """What happened from `begin_s` to `end_s`, host times. Bytes: all over the link, and those of the fetch"""

    begin_s: float
    end_s: float
    carried: int
    fetched: int


def played(round_trip_ms: float, seconds: float, rounds: int) -> tuple[list[Part], list[dict[str, Any]]]:
    """Parts by turns, alone first, and what the vehicle said."""
    parts: list[Part] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        Relayed(KBIT, free_port=free_port, delay_s=round_trip_ms / 2e3) as link,
    ):
        given = {"policy": "auto", "source": str(DATA / "kitti_0005.pcap.xz"), "listen": link.listen}
        keep = str(Path(folder) / "ring")
        car = End(link, "publish", "publisher", settings={"target_kbps": LIVE_KBPS}, keep=keep, **given)
        try:
            car.wait("at")
            with (
                lidarcodec.subscribe(KEYS.prefix, connect=link.connect) as live,
                open_transport(Endpoints.of(connect=link.connect)) as there,
            ):
                _take(live, KEPT_S)
                to_ns = time.time_ns() - 2 * 10**9
                clip = Clip(KEYS, to_ns - int(CLIP_S * 1e9), to_ns)
                for number in range(2 * rounds):
                    store = Path(folder) / str(number) if number % 2 else None
                    parts.append(_part(link, live, seconds, None if store is None else _fetch(clip, store, there)))
        finally:
            car.end()
    return parts, car.said


def _fetch(clip: Clip, folder: Path, transport: Transport) -> Fetch:
    return Fetch(clip, PieceStore(folder), folder / "plan.json", lambda: transport, 60.0)


def _part(link: Relayed, live: lidarcodec.LiveStream, seconds: float, fetch: Fetch | None) -> Part:
    def run() -> None:
        try:
            if fetch is not None:
                fetch.run()
        except CancelledError:
            pass

    thread = threading.Thread(target=run)
    thread.start()
    try:
        _take(live, WARM_UP_S)
        begin_s, carried, fetched = time.time(), link.carried, 0 if fetch is None else fetch.received
        _take(live, seconds)
        received = 0 if fetch is None else fetch.received - fetched
        return Part(begin_s, time.time(), link.carried - carried, received)
    finally:
        if fetch is not None:
            fetch.cancel()
        thread.join()


def _take(live: lidarcodec.LiveStream, seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        live.next(0.2)


def row(round_trip_ms: float, parts: list[Part], said: list[dict[str, Any]]) -> str:
    """A line of the table."""
    delays, used, rates = [], [], []
    for which in (parts[::2], parts[1::2]):
        inside = [one for part in which for one in said if part.begin_s < one.get("at", 0.0) < part.end_s]
        values = [ms for one in inside for ms in one["arrive_ms"]]
        delays.append(" / ".join(f"{percentile(values, q) or 0.0:.0f}" for q in (0.5, 0.95)))
        lasted_s = sum(part.end_s - part.begin_s for part in which)
        used.append(f"{sum(part.carried for part in which) / (lasted_s * KBIT * 125.0):.0%}")
        rates.append(sum(part.fetched for part in which) / lasted_s / 125.0)
    return f"| {round_trip_ms:g} ms | {delays[0]} | {delays[1]} | {rates[1]:.0f} | {', '.join(used)} |"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.past", description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each part")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--round-trip-ms", type=float, action="append", help="default: 0 and 50")
    parser.add_argument("--save", action="store_true")
    options = parser.parse_args()
    trips = options.round_trip_ms or [0.0, 50.0]
    lines = [HEAD, *(row(trip, *played(trip, options.seconds, options.rounds)) for trip in trips)]
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if options.save:
        results.save("past", f"# {TITLE}\n\n{ABOUT}\n\n{text}")


if __name__ == "__main__":
    main()
