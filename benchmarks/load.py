"""A fleet through one router and one server, for as long as wanted: what becomes slower, what grows, what heals.

    python -m benchmarks.load [--minutes 60] [--vehicles 100] [--publishers 4] [--viewers 50] [--requests 10000]

Vehicles are `lidarcodec swarm --shared` at 500 kbit/s each; beside them real publishers adapt to the path. All viewers
look at one vehicle, and requests a minute go to the server's REST interface. A line every ten seconds says how it
stands. Then the router is killed and started again. Exit code 1 if anything failed, stayed away or grew. All of it runs
on this machine: with two processors its load is what limits frames and latency.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from benchmarks.fleet import ROUTER, alive, cpu_s, running, until
from benchmarks.results import save
from benchmarks.soak import LINE_S, WARM_UP, Sizes, grown, sizes
from lidarcodec.transport.endpoints import free_port
from lidarcodec.wire import peek

READY_S: Final = 120.0
HEALED_S: Final = 60.0
"""Longest wait for what a dead router cut off."""
KBPS: Final = 500
FRAMES: Final = 100
"""Of the drive that real publishers play over and over, so that no simulator takes their processor."""
ASKERS: Final = 8
"""Connections over which the requests go."""
PATHS: Final = ("/healthz", "/api/v1/streams/{}/lidar", "/api/v1/streams/{}/lidar/settings", "/api/v1/streams")
"""What is asked for in turn, of one vehicle after the other; the list of all is asked for a tenth as often."""
SLOWER: Final = 1.5
"""The last third may be so many times as slow as the first."""
PYTHON: Final = (sys.executable, "-m", "lidarcodec.cli")


@dataclass
class Times:
    """Times in ms of the last ten seconds, and of each ten seconds before, as (p50, p95)."""

    now: list[float] = field(default_factory=list)
    before: list[tuple[float, float]] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, milliseconds: float) -> None:
        """One more."""
        with self.lock:
            self.now.append(milliseconds)

    def turn(self) -> int:
        """Begin the next ten seconds. Returns how many there were."""
        with self.lock:
            now, self.now = sorted(self.now), []
        if now:
            self.before.append((now[len(now) // 2], now[int(0.95 * (len(now) - 1))]))
        return len(now)

    def said(self) -> str:
        """The last ten seconds, p50 / p95."""
        return " / ".join(f"{value:.0f}" for value in self.before[-1]) if self.before else "-"

    def overall(self) -> str:
        """Medians over all of them."""
        if not self.before:
            return "-"
        return " / ".join(f"{statistics.median(one[place] for one in self.before):.0f}" for place in (0, 1))

    def slower(self) -> float:
        """Median of p95 in the last third against the first; 1 if there is too little to compare."""
        third = len(self.before) // 3
        if third < 2:
            return 1.0
        first, last = (
            statistics.median(p95 for _, p95 in part) for part in (self.before[:third], self.before[-third:])
        )
        return last / first if first else 1.0


class Viewer:
    """Takes the messages of one stream, as a page that decodes them itself."""

    def __init__(self, url: str, ages: Times) -> None:
        self.frames, self.last_s, self._url, self._ages = 0, 0.0, url, ages
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        while not self._stop.is_set():
            with (
                contextlib.suppress(OSError, TimeoutError, WebSocketException),
                connect(self._url, compression=None, max_size=None, open_timeout=30) as socket,
            ):
                while not self._stop.is_set():
                    self._take(socket)
            self._stop.wait(0.5)

    def _take(self, socket: Any) -> None:
        with contextlib.suppress(TimeoutError):
            data = socket.recv(timeout=1.0)
            if isinstance(data, bytes):
                self._ages.add((time.time_ns() - peek(data).stamp_ns) / 1e6)
                self.frames, self.last_s = self.frames + 1, time.monotonic()
                socket.send("ack")

    def close(self) -> None:
        """End it."""
        self._stop.set()
        self._thread.join(35)


class Asker:
    """Asks the server over one connection, at a steady pace."""

    def __init__(self, port: int, every_s: float, vehicles: int, times: Times) -> None:
        self.refused: dict[str, int] = {}
        self._port, self._every_s, self._vehicles, self._times = port, every_s, vehicles, times
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=30)
        due_s, number = time.monotonic(), 0
        while not self._stop.wait(max(0.0, due_s - time.monotonic())):
            due_s, number = max(due_s + self._every_s, time.monotonic() - 1.0), number + 1
            place = 3 if number % 10 == 0 else number % 3
            path = PATHS[place].format(f"car-{1 + number % self._vehicles:03d}")
            begun_s = time.perf_counter()
            try:
                connection.request("GET", path)
                answer = connection.getresponse()
                answer.read()
                said = "" if answer.status == 200 else f"{answer.status} of {PATHS[place]}"
            except (OSError, http.client.HTTPException) as error:
                connection.close()
                said = f"{type(error).__name__} of {PATHS[place]}"
            self._times.add((time.perf_counter() - begun_s) * 1e3)
            if said:
                self.refused[said] = self.refused.get(said, 0) + 1
        connection.close()

    def close(self) -> None:
        """End it."""
        self._stop.set()
        self._thread.join(35)


class Fleet:
    """All processes of a load, viewers and askers. A context manager."""

    def __init__(self, chosen: argparse.Namespace) -> None:
        self.chosen = chosen
        self.endpoint, self.port = f"tcp/127.0.0.1:{free_port()}", free_port()
        self.url = f"127.0.0.1:{self.port}/api/v1/streams"
        self.ages, self.answers = Times(), Times()
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.seen: dict[str, list[Sizes]] = {}
        self.shares: dict[str, list[float]] = {}  # of a processor, in per cent
        self.viewers: list[Viewer] = []
        self.askers: list[Asker] = []
        self._stack = contextlib.ExitStack()
        self.rates: list[tuple[float, float]] = []  # frames a second of a viewer, answers a minute
        self._frames, self._line_s = 0, 0.0
        self._cpu: dict[str, float] = {}

    def __enter__(self) -> Fleet:
        chosen = self.chosen
        folder = self._stack.enter_context(tempfile.TemporaryDirectory())
        try:
            self._start("router", sys.executable, "-c", ROUTER, self.endpoint)
            database = {"LIDARCODEC_DATABASE_URL": f"sqlite:///{folder}/server.db"}
            serve = ("serve", "--port", str(self.port), "--connect", self.endpoint)
            seats = [
                f"--max-viewers{of}={2 * (chosen.viewers + chosen.publishers)}" for of in ("", "-a-client", "-a-host")
            ]
            self._start("server", *PYTHON, *serve, *seats, "--recordings", f"{folder}/recordings", **database)
            swarm = ("swarm", str(chosen.vehicles), chosen.source, "--shared", "--codec", "pcodec")
            self._start("swarm", *PYTHON, *swarm, "--set", f"target_kbps={KBPS}", "--connect", self.endpoint)
            drive = f"{folder}/drive.pcap"
            simulate = [*PYTHON, "simulate", chosen.source, drive, "--frames", str(FRAMES)]
            subprocess.run(simulate, check=True, stdout=subprocess.DEVNULL)
            for number in range(1, chosen.publishers + 1):
                publish = ("publish", drive, "--loop", "--codec", "pcodec", "--set", "target_kbps=auto")
                named = ("--vehicle", f"real-{number}", "--connect", self.endpoint)
                self._start(f"publisher {number}", *PYTHON, *publish, *named)
            until(lambda: self.there() == chosen.vehicles + chosen.publishers, "all vehicles in the list", READY_S)
            looked_at = f"ws://{self.url}/car-001/lidar/frames"
            for _ in range(chosen.viewers):
                self.viewers.append(Viewer(looked_at, self.ages))
                self._stack.callback(self.viewers[-1].close)
            for number in range(1, chosen.publishers + 1):  # who is not looked at sends nothing
                self._stack.callback(Viewer(f"ws://{self.url}/real-{number}/lidar/frames", Times()).close)
            if chosen.requests:
                every_s = 60.0 * ASKERS / chosen.requests
                for _ in range(ASKERS):
                    self.askers.append(Asker(self.port, every_s, chosen.vehicles, self.answers))
                    self._stack.callback(self.askers[-1].close)
            until(lambda: all(viewer.frames for viewer in self.viewers), "a frame for every viewer", READY_S)
        except BaseException:
            self.__exit__()
            raise
        for times in (self.ages, self.answers):
            times.turn()
            times.before.clear()
        self._mark()
        return self

    def __exit__(self, *exc: object) -> None:
        self._stack.close()

    def _start(self, name: str, *command: str, **variables: str) -> None:
        options = {"env": os.environ | variables, "stderr": None}
        self.processes[name] = self._stack.enter_context(running(*command, **options))

    def there(self) -> int:
        """Number of vehicles that the server knows to be alive, and whose status it has."""
        return sum(alive(f"http://{self.url}"))

    def storm(self) -> tuple[float, float]:
        """Kill the router, and start it again. Returns seconds until all vehicles are back, and all viewers have a
        frame."""
        router = self.processes["router"]
        router.send_signal(signal.SIGKILL)
        router.wait(10)
        until(lambda: self.there() == 0, "that the server noticed", HEALED_S)
        begun_s = time.monotonic()
        self._start("router", sys.executable, "-c", ROUTER, self.endpoint)
        until_s: dict[str, float] = {}
        while len(until_s) < 2 and time.monotonic() - begun_s < HEALED_S:
            now_s = time.monotonic()
            if "viewers" not in until_s and all(viewer.last_s > begun_s for viewer in self.viewers):
                until_s["viewers"] = now_s - begun_s
            if "vehicles" not in until_s and self.there() == self.chosen.vehicles + self.chosen.publishers:
                until_s["vehicles"] = time.monotonic() - begun_s
            time.sleep(0.02)
        return until_s.get("vehicles", HEALED_S), until_s.get("viewers", HEALED_S)

    def _mark(self) -> None:
        self._frames = sum(viewer.frames for viewer in self.viewers)
        self._line_s = time.monotonic()
        self._cpu = {name: cpu_s(one.pid) for name, one in self.processes.items()}

    def look(self) -> str:
        """Sizes, rates and times of the last ten seconds, in a line."""
        passed_s = time.monotonic() - self._line_s
        frames = sum(viewer.frames for viewer in self.viewers) - self._frames
        asked = self.answers.turn()
        self.ages.turn()
        self.rates.append((frames / passed_s / max(len(self.viewers), 1), 60 * asked / passed_s))
        used = []
        for name, process in self.processes.items():
            if process.poll() is not None:
                raise SystemExit(f"the {name} ended with code {process.returncode}")
            self.seen.setdefault(name, []).append(now := sizes(process.pid))
            share = 100 * (cpu_s(process.pid) - self._cpu[name]) / passed_s
            self.shares.setdefault(name, []).append(share)
            used.append(f"{name} {share:.0f} %, {now.memory_mib:.0f} MiB, {now.threads}, {now.files}")
        self._mark()
        return (
            f"{self.rates[-1][0]:.1f} frames/s a viewer, age {self.ages.said()} ms; "
            f"{self.rates[-1][1]:,.0f} answers a minute, {self.answers.said()} ms, {sum(self.refused.values())} "
            f"refused; processor, memory, threads, files: {'; '.join(used)}"
        )

    @property
    def refused(self) -> dict[str, int]:
        """Requests that did not end with 200, by what came instead."""
        found: dict[str, int] = {}
        for asker in self.askers:
            for said, count in asker.refused.items():
                found[said] = found.get(said, 0) + count
        return found

    def wrong(self) -> list[str]:
        """What grew or became slow."""
        found = [text for name, seen in self.seen.items() for text in grown(name, seen)]
        for name, times in (("frames", self.ages), ("answers", self.answers)):
            if times.slower() > SLOWER:
                found.append(f"{name} take {times.slower():.1f} times as long at the end as at the beginning")
        return found + [f"{count} times {said}" for said, count in self.refused.items()]


def rows(fleet: Fleet, minutes: float, healed: tuple[float, float]) -> Iterator[tuple[str, str, str]]:
    """The table: what, measured, asked."""
    warm = {name: (seen[min(WARM_UP, len(seen) // 2)], seen[-1]) for name, seen in fleet.seen.items()}
    yield "minutes", f"{minutes:g}", "60"
    frames, answers = (statistics.median(column) for column in zip(*fleet.rates, strict=True))
    yield "frames a second of a viewer, median of ten seconds", f"{frames:.1f}", "10"
    yield "answers a minute, median of ten seconds", f"{answers:,.0f}", f"{fleet.chosen.requests:,}"
    yield "age of frames at viewers, ms, p50 / p95 of ten seconds, median", fleet.ages.overall(), "-"
    yield "the same: last third against first", f"{fleet.ages.slower():.2f} times", "flat"
    yield "answers, ms, p50 / p95 of ten seconds, median", fleet.answers.overall(), "-"
    yield "the same: last third against first", f"{fleet.answers.slower():.2f} times", "flat"
    yield "answers other than 200", str(sum(fleet.refused.values())), "0"
    for name, (first, last) in warm.items():
        share = f"{statistics.median(fleet.shares[name]):.0f} % of a processor, "
        growth = (
            f"{share}{first.memory_mib:.0f} to {last.memory_mib:.0f} MiB, {first.threads} to {last.threads} threads, "
        )
        yield f"{name}, after the warm-up and at the end", f"{growth}{first.files} to {last.files} files", "flat"
    yield "router killed and started: all vehicles are back after", f"{healed[0]:.1f} s", "5 s"
    yield "the same: every viewer has a frame after", f"{healed[1]:.1f} s", "5 s"


def main() -> int:
    """Run, print a line every ten seconds, judge."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--publishers", type=int, default=4, help="that code themselves, and adapt to the path")
    parser.add_argument("--viewers", type=int, default=50, help="of one vehicle")
    parser.add_argument("--requests", type=int, default=10_000, help="a minute")
    parser.add_argument("--source", default="sim:city")
    parser.add_argument("--save", action="store_true")
    chosen = parser.parse_args()
    with Fleet(chosen) as fleet:
        end_s = time.monotonic() + 60 * chosen.minutes
        while time.monotonic() < end_s:
            time.sleep(min(LINE_S, max(0.0, end_s - time.monotonic())))
            print(fleet.look(), flush=True)
        wrong = fleet.wrong()
        table = list(rows(fleet, chosen.minutes, fleet.storm()))
    about = (
        f"{chosen.vehicles} vehicles at {KBPS} kbit/s (pcodec), {chosen.publishers} publishers that adapt, "
        f"{chosen.viewers} viewers of one vehicle, {chosen.requests:,} requests a minute; one router, one server."
    )
    lines = ["| | measured | asked |", "|---|---:|---:|", *(f"| {' | '.join(row)} |" for row in table)]
    text = f"# A fleet through one router and one server\n\n{about}\n\n" + "\n".join(lines) + "\n"
    print(text)
    for said in wrong:
        print(f"WRONG: {said}")
    if chosen.save:
        save("load", text)
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
