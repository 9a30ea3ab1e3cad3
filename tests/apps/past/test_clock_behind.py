"""A vehicle whose clock is behind: what is asked for by another clock lies in its future."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from lidarcodec.apps.past import fetch
from lidarcodec.apps.past.fetch import Fetch
from lidarcodec.apps.past.plan import Clip
from lidarcodec.commands import fetch as command
from lidarcodec.errors import SourceError
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.transport.memory import MemoryNetwork
from tests.apps.past.kept_drive import KEYS, at, kept
from tests.apps.past.test_fetch import Vehicle

HOUR_NS = 3600 * 10**9


def recording(vehicle: Vehicle) -> None:
    """Let the vehicle record a second more with each question, for 8 s."""

    def later(answer: bytes) -> bytes:
        told = json.loads(answer)
        if "until_ns" in told:
            told["until_ns"] += min(vehicle.asked["pieces"], 8) * 10**9
        return json.dumps(told).encode()

    vehicle.spoils = later


def test_a_clip_of_its_future_is_not_waited_for_an_hour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetch, "FRESH_S", 3.0)
    kept(tmp_path / "ring", 30)
    network = MemoryNetwork()
    vehicle = Vehicle(network, tmp_path / "ring")
    recording(vehicle)
    clip = Clip(KEYS, at(5) + HOUR_NS, at(25) + HOUR_NS)
    with network.transport() as near:
        wanted = Fetch(clip, PieceStore(tmp_path / "clip"), tmp_path / "clip" / "plan.json", lambda: near, 20.0)
        with pytest.raises(SourceError, match="nothing from this time: ask for one from 20"):
            wanted.run()
    assert vehicle.asked["pieces"] <= 2


def test_a_vehicle_that_answers_is_not_said_to_be_silent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(command, "ABSENT_S", 0.0)
    clip = Clip(KEYS, at(5), at(25))
    with MemoryNetwork().transport() as near:
        wanted = Fetch(clip, PieceStore(tmp_path), tmp_path / "plan.json", lambda: near, 20.0)
        told = command._Progress(wanted, "car/roof", 20.0)
        wanted.waiting = fetch.RECORDING
        time.sleep(0.01)
        assert told() == "waits for the vehicle to record the rest"
    assert not caplog.records
