"""`publish --keep` and `fetch` over a real network."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from lidarcodec.apps.past.keeper import Keep
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.vehicle import SensorPlan, Vehicle
from lidarcodec.cli import run
from lidarcodec.commands import fetch
from lidarcodec.errors import SourceError
from lidarcodec.recording import RecordingReader
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.base import PacketSource
from lidarcodec.transport import Endpoints
from tests.apps.past.kept_drive import SMALL, at, big, ring
from tests.apps.streams import Loop
from tests.command_line import run_here, the_one_line
from tests.packets import payloads_in
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually


@pytest.mark.sweep
def test_a_clip_of_a_running_vehicle_holds_its_packets(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    car = Publisher(
        Loop(),
        vehicle="car-7",
        sensor="roof",
        keep=Keep(tmp_path / "ring", 8 * 2**20),
        endpoints=Endpoints.of(listen=[endpoint]),
    )
    begin_ns = time.time_ns()
    out = tmp_path / "clip.mcap"
    with car:
        assert eventually(lambda: car.status()["assembled"] >= 15)
        done = run_here(
            "fetch",
            "car-7/roof",
            "--from",
            begin_ns,
            "--to",
            time.time_ns(),
            "-o",
            out,
            "--connect",
            endpoint,
            "--json",
        )
        past = car.status()["past"]
        assert past["stopped"] is None
    assert done.returncode == 0, done.stderr
    about = json.loads(capfd.readouterr().out)
    assert about["frames"] >= 14
    found = payloads_in(str(out))
    dropped = past["counts"].get("dropped", 0)  # by a machine that is too slow
    drive = Loop(about["frames"] + dropped).payloads()
    assert len(found) >= len(drive) - 348 * (dropped + 1)
    if not dropped:
        assert found == drive[: len(found)], "the packets of the drive from its first one on"
    rest = iter(drive)
    assert all(packet in rest for packet in found), "in their order"
    assert [path.name for path in tmp_path.iterdir() if path != out] == ["ring"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--to", "2026-11-26T12:00:00"), "to must be a time such as"),
        (("--to", "12:45"), "not '12:45'. Also -30 for 30 s before now, and now"),
        (("--to", "2026-11-26T11:00:00Z"), "must end after it begins"),
        (("--to", "2026-11-26T14:00:00Z"), "at most 3600 s"),
        (("--to", "now"), "at most 3600 s"),
        (("--to", "2226-11-26T14:00:00Z"), "ten minutes after now"),
        (("--to", "2026-11-26T12:01:00Z", "--quality", "base"), "exact packets only"),
        (("--to", "10"), "write -10 for 10 s before now"),
    ],
)
def test_what_cannot_be_fetched_is_refused_at_once(tmp_path: Path, words: tuple[str, ...], told: str) -> None:
    done = run_here("fetch", "car-7/roof", "--from", "2026-11-26T12:00:00Z", *words, "-o", tmp_path / "clip.mcap")
    assert done.returncode == 2
    assert told in the_one_line(done)


def test_nobody_there_is_reported_while_it_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Patience is ten minutes long, and a wrong name looks like a slow vehicle."""
    monkeypatch.setattr(fetch, "ABSENT_S", 0.05)
    words = ["fetch", "car-9/roof", "--from", "-10", "--to", "now", "-o", str(tmp_path / "clip.mcap")]
    assert run([*words, "--patience", "1", "--listen", f"tcp/127.0.0.1:{free_port()}"]) == 1
    assert "nobody has answered for car-9/roof yet" in caplog.text


def test_a_vehicle_whose_sensor_has_failed_still_gives_what_it_kept(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    ring(tmp_path / "ring", 0, 30)

    def unplugged() -> PacketSource:
        raise SourceError("no such interface: eth7")

    plan = SensorPlan("roof", unplugged, StreamSettings(), keep=Keep(tmp_path / "ring", SMALL))
    out = tmp_path / "clip.mcap"
    with Vehicle("car-7", [plan], Endpoints.of(listen=[endpoint])) as vehicle:
        assert eventually(lambda: set(vehicle.failures()) == {"roof"})
        words = ("fetch", "car-7/roof", "--from", at(0), "--to", at(25), "-o", out, "--connect", endpoint)
        done = run_here(*words)
    assert done.returncode == 0, done.stderr
    with out.open("rb") as file:
        assert [data for _, data in RecordingReader(file).messages()] == [big(number) for number in range(30)]
