"""Many vehicles at once: each is a stream of its own that a receiver decodes."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

import lidarcodec
from lidarcodec.apps.swarm import Swarm, vehicle_names
from lidarcodec.apps.swarm_shared import SharedSwarm, encoded
from lidarcodec.errors import SettingsError
from lidarcodec.settings import StreamSettings
from tests.apps.streams import Loop
from tests.command_line import run, start, the_one_line
from tests.sweeps import sampled
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

SETTINGS = StreamSettings(codec="pcodec", key_interval=3)
FRAMES = 4


@pytest.mark.parametrize("kind", sampled(["each for itself", "shared"], ["shared"]))
def test_every_vehicle_of_a_swarm_can_be_decoded_and_asked_for_a_key_frame(kind):
    endpoints = lidarcodec.Endpoints(loopback_port=free_port())
    loop = Loop(FRAMES)
    packets, names = list(loop.packets()), vehicle_names("car", 1, 3)
    if kind == "shared":
        swarm = SharedSwarm(names, encoded(loop.sensor, packets, SETTINGS), SETTINGS, endpoints=endpoints)
    else:
        swarm = Swarm(names, loop.sensor, packets, SETTINGS, endpoints=endpoints)
    wanted = {packet.payload for packet in packets}
    with swarm:
        for name in names[1:]:
            with lidarcodec.LiveStream(f"{name}/lidar", endpoints=endpoints, newest=False, timeout_s=20.0) as live:
                frames = [frame for frame, _ in zip(live, range(2 * FRAMES + 1), strict=False)]
                assert len(frames) == 2 * FRAMES + 1
                for frame in frames:
                    assert {packet.payload for packet in lidarcodec.packets_of(frame)} <= wanted
                assert live.summary()["errors"] == {}
                assert live.summary().get("restarts", 0) == 0
                assert live.summary()["latency_ms"]["p50"] is not None
        streams = {status["stream_id"] for status in swarm.statuses()}
    assert len(streams) == len(names)
    assert swarm.failure is None


@pytest.mark.parametrize("codec", ["pcodec", "predictive"])
def test_a_shared_vehicle_sends_what_somebody_takes_and_counts_the_rest(codec):
    """It would load a router with frames that a publisher leaves out."""
    endpoints, loop = lidarcodec.Endpoints(loopback_port=free_port()), Loop(FRAMES)
    settings = SETTINGS.changed(codec=codec, key_interval=50)
    swarm = SharedSwarm(["car"], encoded(loop.sensor, list(loop.packets()), settings), settings, endpoints=endpoints)

    def counts():
        return swarm.statuses()[0]

    with swarm:
        assert eventually(lambda: counts()["no_receiver"] >= 3)
        assert counts()["frames"] == 0
        with lidarcodec.LiveStream("car/lidar", endpoints=endpoints, newest=False, timeout_s=60.0) as live:
            assert live.next(60.0) is not None
            for _ in range(2 * FRAMES):
                assert live.next(60.0) is not None
            assert live.summary()["errors"] == {}
        assert eventually(lambda: counts()["flight"]["arrive_ms"]["p50"] is not None)
    assert swarm.failure is None
    status = counts()
    assert status["assembled"] == status["frames"] + status["replaced"] + status["no_receiver"]


def test_names_that_are_none_are_refused():
    with pytest.raises(SettingsError):
        vehicle_names("a car", 1, 2)


def test_the_command_runs_a_swarm_in_one_process_and_in_several():
    port = str(free_port())
    options = ("--seconds", "1", "--frames", "2", "--codec", "zstd")
    for more in (("--processes", "2"), ("--shared",)):
        done = run("swarm", "3", "sim:road", *options, *more, LIDARCODEC_LOOPBACK_PORT=port)
        assert done.returncode == 0, done.stderr
        lines = done.stdout.splitlines()
        assert [int(line.split()[0]) for line in lines] == [3]
    assert run("swarm", "0").returncode == 2
    assert run("swarm", "1", "sim:road", "--codec", "mp3").returncode == 2


def test_a_source_that_cannot_be_opened_is_told_once_and_not_by_every_part():
    result = run("swarm", 3, "no-such-file.pcap", "--processes", 3)
    assert result.returncode == 1
    assert "no-such-file.pcap does not exist" in the_one_line(result)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGKILL], ids=lambda number: number.name)
def test_no_process_of_a_swarm_outlives_it(number):
    """A terminal that was closed left processes that published for ever."""
    words = ("swarm", "2", "sim:road", "--processes", "2", "--frames", "2", "--codec", "raw")
    process = start(*words, variables={"LIDARCODEC_LOOPBACK_PORT": str(free_port())})
    try:
        assert eventually(lambda: len(children(process.pid)) == 2)
        parts = children(process.pid)
        process.send_signal(number)
        assert process.wait(60) == -number
        assert eventually(lambda: not any(Path(f"/proc/{part}").exists() for part in parts))
    finally:
        process.kill()
        process.communicate()


def test_a_part_that_is_ended_too_soon_is_an_error():
    """Of SIGTERM it ends with exit code 0, as live commands do."""
    words = ("swarm", "2", "sim:road", "--processes", "2", "--frames", "2", "--codec", "raw", "--seconds", "60")
    process = start(*words, variables={"LIDARCODEC_LOOPBACK_PORT": str(free_port())})
    try:
        assert eventually(lambda: len(children(process.pid)) == 2)
        time.sleep(3.0)
        os.kill(children(process.pid)[-1], signal.SIGTERM)
        _, complaint = process.communicate(timeout=60)
        assert process.returncode == 1
        assert "a process of the swarm failed" in complaint
    finally:
        process.kill()
        process.communicate()


def children(pid: int) -> list[int]:
    found = Path(f"/proc/{pid}/task/{pid}/children")
    if not found.exists():
        pytest.skip("needs a Linux that lists the children of a process")
    return [int(word) for word in found.read_text().split()]
