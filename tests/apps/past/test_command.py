"""`publish --keep` and `fetch` over a real network."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from lidarcodec import open_source
from lidarcodec.apps.past.keeper import Keep
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.transport import Endpoints
from tests.apps.streams import Loop
from tests.command_line import run_here, the_one_line
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually


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
        assert eventually(lambda: car.status()["assembled"] >= 15, 30.0)
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
        assert car.status()["past"]["stopped"] is None
    assert done.returncode == 0, done.stderr
    about = json.loads(capfd.readouterr().out)
    assert about["frames"] >= 14
    with open_source(str(out)) as clip:
        found = [packet.payload for packet in clip.packets()]
    assert found == Loop(about["frames"]).payloads()[: len(found)], "the packets of the drive from its first one on"
    assert [path.name for path in tmp_path.iterdir() if path != out] == ["ring"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--to", "2026-11-26T12:00:00"), "to must be a time such as"),
        (("--to", "2026-11-26T11:00:00Z"), "must end after it begins"),
        (("--to", "2026-11-26T14:00:00Z"), "at most 3600 s"),
        (("--to", "2226-11-26T14:00:00Z"), "ten minutes after now"),
        (("--to", "2026-11-26T12:01:00Z", "--quality", "base"), "exact packets only"),
    ],
)
def test_what_cannot_be_fetched_is_refused_at_once(tmp_path: Path, words: tuple[str, ...], told: str) -> None:
    done = run_here("fetch", "car-7/roof", "--from", "2026-11-26T12:00:00Z", *words, "-o", tmp_path / "clip.mcap")
    assert done.returncode == 2
    assert told in the_one_line(done)
