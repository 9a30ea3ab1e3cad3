"""The keeper of a vehicle, and a fetch, are killed again and again at random moments; a marked clip has to stay."""

from __future__ import annotations

import logging
import multiprocessing
import os
import random
import signal
import tempfile
import threading
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from lidarcodec.apps.once import Once
from lidarcodec.apps.past.answers import Answers
from lidarcodec.apps.past.clip import write_clip
from lidarcodec.apps.past.fetch import Fetch
from lidarcodec.apps.past.keeper import Keep, Keeper
from lidarcodec.apps.past.kept import Kept
from lidarcodec.apps.past.plan import Clip
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.frame import Frame
from lidarcodec.recording.marks import Mark
from lidarcodec.recording.pieces import messages_in, pieces_in, read_piece
from lidarcodec.recording.recorded_files import recorded_files
from lidarcodec.transport import Endpoints, open_transport, part_size
from lidarcodec.wire import peek
from tests.apps.past.kept_drive import FRAME_NS, KEYS, SMALL, at, frames, packets
from tests.faults.outcome import Outcome
from tests.packets import payloads_in
from tests.transport.conftest import free_port

KEEPER_KILLS, FETCH_KILLS = 120, 80
MARKED = 20
"""Frames that are marked."""
PROCESS = multiprocessing.get_context("fork")
"""Forked, as each of hundreds of processes would take longer to start than it lives."""


def run(keeper_kills: int = KEEPER_KILLS, fetch_kills: int = FETCH_KILLS) -> Outcome:
    moments = random.Random(31)
    with tempfile.TemporaryDirectory() as folder:
        ring, wrong, written = Path(folder) / "ring", [], 0
        turn = frames(MARKED)
        _kept(ring, turn, 0, None)
        Kept(ring, KEYS, SMALL).mark(Mark("crash", at(0), at(MARKED), "", "", at(MARKED)))
        first = MARKED
        for kill in range(keeper_kills):
            told = _killed(_keep, (ring, turn, first), moments.uniform(0.0, 0.8))
            found = _indices(ring, first)
            if found != list(range(first, first + len(found))) or len(found) < told:
                wrong.append(f"kill {kill} of the keeper: {told} frames were written, and {len(found)} are there")
            written += told
            first += 1000
        fetched, resumed = _fetched(ring, fetch_kills, moments, wrong)
        if fetched != [packet.payload for packet in packets(MARKED)]:
            wrong.append("the marked clip is not what was kept")
    return Outcome(
        f"keeper killed {keeper_kills} times, then a fetch of a marked clip {fetch_kills} times, at random moments",
        None,
        f"no message that was written ({written} in all), nothing of the clip",
        f"keeper: nothing; fetch: it went on {resumed} times with what was there",
        {},
        wrong,
    )


def _fetched(ring: Path, kills: int, moments: random.Random, wrong: list[str]) -> tuple[list[bytes], int]:
    """The payloads of the marked clip, and how often a fetch went on with a part of it."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    vehicle = PROCESS.Process(target=_answer, args=(ring, endpoint))
    vehicle.start()
    store, before, resumed = ring.parent / "store", 0, 0
    try:
        for kill in range(kills):
            _killed(_fetch, (store, endpoint), moments.uniform(0.1, 0.9))
            there = sum(path.stat().st_size for path in store.glob("*.p*")) if store.is_dir() else 0
            if there < before:
                wrong.append(f"kill {kill} of the fetch: {before} bytes were there, and {there} are left")
            before, resumed = there, resumed + (there > before > 0)
        done = PROCESS.Process(target=_fetch, args=(store, endpoint, None))
        done.start()
        done.join(300.0)
    finally:
        vehicle.kill()
        vehicle.join()
    clip = ring.parent / "clip.mcap"
    write_clip(_new_fetch(store, endpoint).plan, PieceStore(store), clip)
    return payloads_in(clip)[: 348 * MARKED], resumed


def _killed(work: Any, given: tuple[Any, ...], after_s: float) -> int:
    """Kill a process so long after it has begun to tell something. Returns the last number that it told."""
    near, far = PROCESS.Pipe(duplex=False)
    process = PROCESS.Process(target=work, args=(*given, far))
    process.start()
    far.close()
    told = 0
    try:
        near.poll(30.0)
        time.sleep(after_s)
        if process.pid is not None:
            os.kill(process.pid, signal.SIGKILL)
        while near.poll():
            told = near.recv()
    except EOFError:
        pass
    process.join()
    near.close()
    return told


def _keep(ring: Path, turn: list[Frame], first: int, told: Connection) -> None:
    _kept(ring, turn, first, told)


def _kept(ring: Path, turn: list[Frame], first: int, told: Connection | None) -> None:
    """Keep frames until killed, and tell how many were written; without `told`, one turn of them."""
    keeper = Keeper(Keep(ring, SMALL), KEYS)
    keeper.start()
    number = 0
    while told is not None or number < len(turn):
        frame = turn[number % len(turn)]
        keeper.frame(replace(frame, index=first + number, stamp_ns=at(0) + (first + number) * FRAME_NS))
        number += 1
        time.sleep(0.02)
        if told is not None:
            told.send(int(keeper.state()["counts"].get("frames", 0)))
    keeper.close()


def _indices(ring: Path, first: int) -> list[int]:
    """Indices of the kept frames of one process, each of them read and compared with its hash."""
    found = []
    for path in recorded_files(ring, KEYS.vehicle, KEYS.sensor):
        if not path.stat().st_size:  # killed before its first byte
            continue
        for piece in pieces_in(path):
            heads = [peek(data) for data in messages_in(read_piece(path, piece))]
            found += [head.frame_index for head in heads if head.stamp_ns >= at(first)]
    return found


class Narrow:
    """A link that live messages leave free for two of a hundred milliseconds."""

    @property
    def busy(self) -> bool:
        return time.time() % 0.1 < 0.098

    def room(self, most: int, least: int) -> None:
        return None


def _answer(ring: Path, endpoint: str) -> None:
    """Answer as a vehicle whose live stream leaves little room."""
    with open_transport(Endpoints.of(listen=[endpoint])) as transport:
        Answers(Kept(ring, KEYS, SMALL), KEYS, Narrow, lambda: 0.0, Once(logging.getLogger(__name__))).declare(
            transport
        )
        threading.Event().wait()


def _new_fetch(store: Path, endpoint: str) -> Fetch:
    def none() -> Any:
        raise AssertionError(endpoint)

    return Fetch(Clip(KEYS, at(0), at(MARKED)), PieceStore(store), store / "plan.json", none, 60.0)


def _fetch(store: Path, endpoint: str, told: Connection | None) -> None:
    """Fetch until killed."""
    with open_transport(Endpoints.of([endpoint])) as transport:
        fetch = Fetch(Clip(KEYS, at(0), at(MARKED)), PieceStore(store), store / "plan.json", lambda: transport, 60.0)
        if told is not None:
            part_size.MAX_PART = 8192  # so that it is not over before it is killed
            told.send(0)
        fetch.run()
