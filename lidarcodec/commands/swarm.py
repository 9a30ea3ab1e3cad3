"""`lidarcodec swarm`: publishes many vehicles at once, to load a network, a router or a server."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from lidarcodec.apps.swarm import Swarm, loaded, vehicle_names
from lidarcodec.apps.swarm_shared import SharedSwarm, encoded
from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.results.live import Swarmed
from lidarcodec.commands.running.stopping import stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.settings import one_setting
from lidarcodec.errors import SourceError
from lidarcodec.sources import open_source

TICK_S = 0.1
END_S = 30.0


@dataclass(frozen=True)
class Load:
    """The load of a swarm. frames: frames of the source to repeat; seconds: duration, None for no end"""

    count: int
    spec: str
    prefix: str
    codec: str | None
    pairs: list[str]
    rate: float
    frames: int
    shared: bool
    seconds: float | None
    given: Given
    first: int = 1

    def words(self, count: int, first: int) -> list[str]:
        """Command line of a part of this swarm."""
        connect, listen, config = self.given
        options: list[tuple[str, object]] = [
            ("--vehicle-prefix", self.prefix),
            ("--rate", self.rate),
            ("--frames", self.frames),
            ("--processes", 1),
            ("--first", first),
        ]
        options += [("--codec", self.codec)] if self.codec else []
        options += [("--seconds", self.seconds)] if self.seconds else []
        options += [("--set", pair) for pair in self.pairs]
        options += [("--connect", one) for one in connect] + [("--listen", one) for one in listen]
        options += [("--zenoh-config", config)] if config else []
        return ["swarm", str(count), self.spec, "--json", *(str(word) for option in options for word in option)]


def run(load: Load, processes: int | None, as_json: bool = False) -> None:
    """Publish until a signal arrives, or for `load.seconds`.

    Raises SettingsError, SourceError, TransportError.
    """
    one_setting(load.codec, load.pairs)
    endpoints_of(load.given)
    several = 1 if load.shared else min(load.count, processes or os.cpu_count() or 1)
    if several == 1:
        parts = [_run_here(load)]
    else:
        with open_source(load.spec):  # here, so that an error is reported once and not by every part
            pass
        parts = _run_parts(load, several)
    tell(added(parts), line_of(added(parts)), as_json)


def _run_here(load: Load) -> Swarmed:
    settings, endpoints = one_setting(load.codec, load.pairs), endpoints_of(load.given)
    names = vehicle_names(load.prefix, load.first, load.count)
    sensor, packets = loaded(load.spec, load.frames)
    swarm: Swarm | SharedSwarm
    if load.shared:
        messages = encoded(sensor, packets, settings)
        swarm = SharedSwarm(names, messages, settings, rate=load.rate, endpoints=endpoints)
    else:
        swarm = Swarm(names, sensor, packets, settings, rate=load.rate, endpoints=endpoints)
    end = float("inf") if load.seconds is None else time.monotonic() + load.seconds
    with stoppable(swarm.interrupt) as stopped, swarm:
        while not stopped() and time.monotonic() < end and swarm.failure is None:
            time.sleep(TICK_S)
        statuses = swarm.statuses()
    if swarm.failure is not None and not stopped():
        raise swarm.failure
    return totals(statuses, settings.codec)


def _run_parts(load: Load, several: int) -> list[Swarmed]:
    """Run parts of the swarm in processes of their own. If one ends early, all end; they also end with this process."""
    begin, parts, failed = load.first, [], False
    end_s = time.monotonic() + (math.inf if load.seconds is None else load.seconds)
    with stoppable() as stopped:
        try:
            for number in range(several):
                size = (load.count - (begin - load.first)) // (several - number)
                command = [sys.executable, "-P", "-m", "lidarcodec.commands.running.attached", *load.words(size, begin)]
                parts.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE))
                begin += size
            while not stopped() and all(part.poll() is None for part in parts):
                time.sleep(TICK_S)
            failed = not stopped() and time.monotonic() < end_s  # even with exit code 0, as after SIGTERM
        finally:
            if failed or stopped() or any(part.poll() for part in parts):
                for part in parts:
                    part.terminate()
            for part in parts:
                if not _ends(part):
                    failed = True
    if failed or any(part.returncode for part in parts):
        raise SourceError("a process of the swarm failed; its own message is above")
    return [cast(Swarmed, json.loads(part.stdout.read())) for part in parts if part.stdout is not None]


def _ends(part: subprocess.Popen[bytes]) -> bool:
    """Whether a process ends by itself within END_S. Otherwise it is killed; it may be stopped by SIGSTOP."""
    try:
        part.wait(END_S)
    except subprocess.TimeoutExpired:
        part.kill()
        part.wait()
        return False
    return True


def totals(statuses: list[dict[str, Any]], codec: str) -> Swarmed:
    """Totals of all vehicles."""

    def total(field: str) -> int:
        return sum(status[field] for status in statuses)

    return Swarmed(
        vehicles=len(statuses),
        codec=codec,
        frames=total("frames"),
        bytes=total("bytes"),
        replaced=total("replaced"),
        no_receiver=total("no_receiver"),
        left_out=total("left_out"),
    )


def added(parts: Sequence[Swarmed]) -> Swarmed:
    """Totals of all parts of a swarm."""
    whole = totals([dict(part) for part in parts], parts[0]["codec"])
    whole["vehicles"] = sum(part["vehicles"] for part in parts)
    return whole


def line_of(found: Swarmed) -> str:
    """The totals, in one line."""
    return (
        f"{found['vehicles']} vehicles with {found['codec']}: {found['frames']} frames in {found['bytes']:,} bytes "
        f"sent, {found['replaced']} replaced, {found['no_receiver']} without a receiver"
        + f", {found['left_out']} left out to keep the target"
        * bool(found["left_out"])
    )
