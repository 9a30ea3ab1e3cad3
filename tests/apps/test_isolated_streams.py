"""Live streams whose codecs run in processes of their own: what happens to those is seen, and the stream goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import pytest

import lidarcodec
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.errors import SettingsError
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.memory import MemoryNetwork
from tests.apps.streams import Loop
from tests.apps.test_isolation import LONG, gone
from tests.apps.test_processes import End
from tests.conftest import ROOT
from tests.sweeps import sampled
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def stream():
    """A publisher and a subscriber, both with isolated codecs, over memory; no thread is left afterwards."""
    before, network = set(threading.enumerate()), MemoryNetwork()
    here, there = network.transport(), network.transport()
    car = Publisher(Loop(), LONG, transport=here, rate=30.0, isolate="always")
    with car, subscribe(transport=there, newest=False, isolate="always") as live:
        assert live.next(60)
        yield car, live
        pids = [car.status()["worker"]["pid"], live.summary()["worker"]["pid"]]
    here.close()
    there.close()
    assert all(gone(pid) for pid in pids if pid)
    assert eventually(lambda: set(threading.enumerate()) <= before), threading.enumerate()


def advances(live, number: int = 5) -> None:
    """The stream goes on."""
    for _ in range(number):
        assert live.next(60)


@pytest.mark.parametrize("fault", sampled([signal.SIGKILL, signal.SIGSTOP], [signal.SIGKILL]))
def test_a_stream_outlives_its_encoders_process(stream, fault):
    car, live = stream
    keys = car.status()["key_frames"]
    os.kill(car.status()["worker"]["pid"], fault)
    assert eventually(lambda: car.status()["worker_restarts"] == 1)
    assert eventually(lambda: car.status()["key_frames"] > keys)
    advances(live)
    cause = "gave no answer" if fault == signal.SIGSTOP else f"killed by {fault.name}"
    assert car.status()["errors"][f"worker {cause}"] == 1
    assert car.status()["worker"]["state"] == "running"
    assert live.summary()["errors"] == {}
    assert live.stats.counts["restarts"] == 0


@pytest.mark.sweep
def test_a_stream_outlives_its_decoders_process(stream):
    car, live = stream
    keys = car.status()["key_frames"]
    os.kill(live.summary()["worker"]["pid"], signal.SIGSEGV)
    assert eventually(lambda: live.summary()["worker_restarts"] == 1)
    advances(live)
    assert car.status()["key_frames"] > keys
    assert live.summary()["errors"]["worker killed by SIGSEGV"] == 1


@pytest.mark.sweep
def test_a_codec_that_needs_a_process_gets_it_before_the_change():
    """The stream does not stand still meanwhile, and the receiver, which nobody tells the codec, has one ready too."""
    network = MemoryNetwork()
    here, there = network.transport(), network.transport()
    with Publisher(Loop(), LONG, transport=here, rate=10.0) as car, subscribe(transport=there, newest=False) as live:
        advances(live)
        assert (car.status()["worker"], live.summary()["worker"]) == (None, None)
        for codec in ("h264", "h264-log"):
            applied = car.change(codec=codec)
            assert applied.key
            assert car.status()["worker"]["state"] == "running"
            while live.next(60).index < applied.first_frame + 3:
                pass
            assert live.summary()["worker"]["state"] == "running"
        pid = car.status()["worker"]["pid"]
        applied = car.change(codec="zstd")
        assert gone(pid)
        while live.next(60).index < applied.first_frame + 3:
            pass
        assert car.status()["errors"] == live.summary()["errors"] == {}
        assert (car.status()["worker_restarts"], car.status()["preparing"]) == (0, None)
    here.close()
    there.close()


def test_without_a_process_settings_are_refused_and_a_stream_that_needs_one_still_ends(monkeypatch):
    """Whatever is wrong with the machine: nothing waits for ever, and the reason is told."""
    network = MemoryNetwork()
    here, there = network.transport(), network.transport()
    with subscribe(transport=there, isolate="never") as live:
        with Publisher(Loop(), LONG, transport=here, rate=20.0) as car:
            assert live.next(60)
            monkeypatch.setattr(sys, "executable", "/nowhere/python")
            for _ in range(2):  # the first failure is followed by a start at once
                with pytest.raises(SettingsError, match="cannot start a process"):
                    car.change(codec="h264")
            assert car.settings.codec == "zstd"
            assert live.next(60)
        car = Publisher(Loop(6), LONG, transport=here, rate=40.0, isolate="always")
        car.run()
        assert car.status()["errors"]["worker not started"] >= 2
        assert car.status()["errors"]["encode errors"] >= 1
        assert car.status()["frames"] == 0
    here.close()
    there.close()


@pytest.mark.sweep
def test_a_source_that_ends_is_flushed_through_the_process():
    network = MemoryNetwork()
    here, there = network.transport(), network.transport()
    settings = StreamSettings(codec="jpeg-layered", codec_settings={"group": 4})
    with (
        subscribe(transport=there, newest=False, until_end=True, isolate="always") as live,
        Publisher(Loop(6), settings, transport=here, rate="max", isolate="always"),
    ):
        assert [frame.index for frame in live] == [0, 1, 2, 3, 4, 5]
    here.close()
    there.close()


@pytest.mark.sweep
def test_over_the_network_both_sides_lose_their_processes_and_go_on(monkeypatch):
    monkeypatch.setenv("LIDARCODEC_ISOLATE", "always")
    port = free_port()
    with lidarcodec.subscribe(loopback_port=port, newest=False) as live:
        car = End("publish", loopback_port=port, rate=10)
        try:
            advances(live)
            assert eventually(lambda: car.status.get("worker"))
            theirs = car.status["worker"]["pid"]
            os.kill(theirs, signal.SIGSEGV)
            assert eventually(lambda: car.status["worker_restarts"] == 1)
            os.kill(live.summary()["worker"]["pid"], signal.SIGKILL)
            assert eventually(lambda: live.summary()["worker_restarts"] == 1)
            advances(live)
            assert car.status["errors"]["worker killed by SIGSEGV"] == 1
            last = car.status["worker"]["pid"]
        finally:
            car.end()
    assert car.process.returncode == 0
    assert eventually(lambda: gone(theirs) and gone(last))


@pytest.mark.sweep
def test_a_terminals_interrupt_ends_the_stream_and_its_process_quietly(monkeypatch):
    """Ctrl-C goes to the whole group: the publisher ends its stream, its codec does not die before."""
    port = free_port()
    command = [sys.executable, "-m", "lidarcodec", "publish", "sim:road", "--listen", f"tcp/127.0.0.1:{port}"]
    with (
        lidarcodec.subscribe(connect=f"tcp/127.0.0.1:{port}", isolate="never") as live,
        subprocess.Popen(
            command,
            cwd=ROOT,
            env=os.environ | {"LIDARCODEC_ISOLATE": "always"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            process_group=0,
        ) as car,
    ):
        advances(live)
        assert eventually(lambda: (live.status or {}).get("worker"))
        pid = live.status["worker"]["pid"]
        os.killpg(car.pid, signal.SIGINT)
        said, complaints = car.communicate(timeout=60)
    assert (car.returncode, complaints) == (0, "publishing vehicle/lidar\n")
    assert " a second, in " in said
    assert gone(pid)
