"""Codecs in a process of their own, killed, crashed, stopped and starved: a stream loses a frame and goes on."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import lidarcodec
from lidarcodec import wire
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.worker.isolation import Isolation
from lidarcodec.assembly import packets_of
from lidarcodec.codecs import table
from lidarcodec.errors import MissingReferenceError, SectionError, SettingsError, WorkerError
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings, settings_from
from tests.apps.streams import Loop
from tests.codecs.test_other_sensors import SMALL
from tests.codecs.test_other_sensors_pictures import framed
from tests.conftest import ROOT
from tests.contracts import frames
from tests.contracts.codec import assert_equal, from_table
from tests.sweeps import sampled
from tests.transport.test_contract import eventually

pytestmark = pytest.mark.timeout(120)

LONG = StreamSettings(codec="zstd", key_interval=10_000)
SCENES = [frames.scene(8, index=index) for index in range(12)]


def gone(pid: int) -> bool:
    """Whether there is no such process, not even a dead one that nobody collected."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


class Ends:
    """An encoder and a decoder, each in a process of its own."""

    def __init__(self, settings: StreamSettings) -> None:
        self.failures: list[WorkerError] = []
        self.sender, self.receiver = (Isolation("always", self.failures.append, 60.0) for _ in range(2))
        self.encoder = StreamEncoder(settings, 7, self.sender.make_encoder)
        self.decoder = StreamDecoder(self.receiver.make_decoder)

    def close(self) -> None:
        pids = [one.state()["pid"] for one in (self.sender, self.receiver) if one.state()]
        self.sender.close()
        self.receiver.close()
        assert all(gone(pid) for pid in pids if pid)


@pytest.fixture
def ends():
    """Function that makes ends; afterwards their processes are gone."""
    made = []

    def make(settings: StreamSettings = LONG) -> Ends:
        made.append(Ends(settings))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.mark.sweep
def test_frames_and_messages_are_those_of_this_process(ends):
    """One stream after the other through the same two processes."""
    pair = ends()
    for codec in ("zstd", "pcodec", "jpeg-layered"):
        settings = StreamSettings(codec=codec, codec_settings={"group": 4} if codec == "jpeg-layered" else {})
        there, here = StreamEncoder(settings, 7, pair.sender.make_encoder), StreamEncoder(settings, 7)
        decoder = StreamDecoder(pair.receiver.make_decoder)
        sent = SCENES[:6] if codec == "jpeg-layered" else [*frames.ordinary().values()]
        messages = [message for frame in sent for message in there.encode(frame)] + there.flush()
        expected = [message for frame in sent for message in here.encode(frame)] + here.flush()
        assert [wire.pack(message) for message in messages] == [wire.pack(message) for message in expected]
        came = [frame for message in messages for frame in decoder.decode(message)] + decoder.flush()
        assert len(came) == len(sent)
        for one, other in zip(came, sent, strict=True):
            assert_equal(one, other, from_table(codec))
    assert pair.failures == []


@pytest.mark.parametrize("codec", sampled(["h264", "zstd"], ["zstd"]))
def test_frames_of_other_sensors_go_there_and_back_as_a_whole(ends, codec):
    pair, settings = ends(), settings_from({"codec": codec, "reduction": "columns:2"})
    there = StreamEncoder(settings, 7, pair.sender.make_encoder, pair.sender.make_other_encoder)
    here = StreamEncoder(settings, 7)
    decoder = StreamDecoder(pair.receiver.make_decoder, pair.receiver.make_other_decoder)
    for index, capture in enumerate(("vlp16", "vlp16", SMALL[2])):
        frame = framed(capture, 16).with_(index=index)
        messages = there.encode(frame)
        assert [wire.pack(message) for message in messages] == [wire.pack(message) for message in here.encode(frame)]
        (decoded,) = (one for message in messages for one in decoder.decode(message))
        assert decoded.sensor.hash == frame.sensor.hash
        assert len(packets_of(decoded)) == len(packets_of(frame))
        np.testing.assert_array_equal(decoded.range > 0, here.reduced.valid)
    assert pair.failures == []


def starve(pid: int) -> None:
    """Leave a process no more address space than it has."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[0])
    resource.prlimit(pid, resource.RLIMIT_AS, (pages * resource.getpagesize(), resource.RLIM_INFINITY))


def strike(side: Isolation, fault: signal.Signals, ask: Callable[[], object]) -> None:
    """Hit a process with a signal in the middle of its work."""
    pid, process = side.state()["pid"], side._keeper._process
    os.kill(pid, signal.SIGSTOP)
    if fault == signal.SIGSTOP:
        process._limit_s = 1.0  # of this one only: the next one's answers may take their time on a busy machine

    def hit() -> None:
        eventually(process._asking.locked, 30)
        os.kill(pid, fault)
        if fault != signal.SIGSTOP:
            os.kill(pid, signal.SIGCONT)

    thread = threading.Thread(target=hit)
    thread.start()
    try:
        ask()
    finally:
        thread.join()


FAULTS = [
    (signal.SIGKILL, "killed by SIGKILL"),
    (signal.SIGSEGV, "killed by SIGSEGV"),
    (signal.SIGSTOP, "gave no answer"),
    ("memory", "raised"),
]


@pytest.mark.parametrize(("fault", "cause"), sampled(FAULTS, FAULTS[2:3]))
def test_a_fault_costs_a_frame_and_a_key_frame_follows(ends, fault, cause):
    """Of an encoder, then of its decoder, which needs that key frame and says so."""
    pair = ends()
    big = frames.scene(348, index=2)  # more than fits the memory, or the buffers, that a process has left
    for frame in SCENES[:2]:
        for message in pair.encoder.encode(frame):
            assert pair.decoder.decode(message)

    def failed(side: Isolation, ask: Callable[[], object]) -> None:
        pid = side.state()["pid"]
        if fault == "memory":
            starve(pid)
        with pytest.raises(WorkerError, match=f"process {pid}") as seen:
            ask() if fault == "memory" else strike(side, fault, ask)
        assert (seen.value.cause, seen.value.resting) == (cause, False)
        assert gone(pid)
        assert side.state()["last_failure"] == str(seen.value)

    failed(pair.sender, lambda: pair.encoder.encode(big))
    (message,) = pair.encoder.encode(big.with_(index=3))
    assert message.key
    failed(pair.receiver, lambda: pair.decoder.decode(message))
    (after,) = pair.encoder.encode(big.with_(index=4))
    with pytest.raises(MissingReferenceError):
        pair.decoder.decode(after)
    (key,) = pair.encoder.encode(big.with_(index=5), key=True)
    assert_equal(*pair.decoder.decode(key), big.with_(index=5), from_table("zstd"))
    assert (pair.sender.restarts, pair.receiver.restarts) == (1, 1)
    assert [error.cause for error in pair.failures] == [cause, cause]


def test_a_process_that_died_unasked_costs_no_frame(ends):
    pair = ends()
    pair.encoder.encode(SCENES[0])
    pid = pair.sender.state()["pid"]
    os.kill(pid, signal.SIGKILL)
    assert eventually(lambda: os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None)
    assert [message.key for message in pair.encoder.encode(SCENES[1])] == [True]
    assert pair.sender.restarts == 1


def test_errors_of_a_codec_keep_type_and_attributes_and_the_process(ends):
    pair = ends()
    (key,), (inter,) = pair.encoder.encode(SCENES[0]), pair.encoder.encode(SCENES[1])
    with pytest.raises(MissingReferenceError) as seen:
        pair.decoder.decode(inter)
    assert seen.value.needs == 1  # its calibration is missing: the refused frame itself
    with pytest.raises(SectionError):
        pair.decoder.decode(lidarcodec.Message(**(vars(key) | {"sections": key.sections[:2]})))
    assert pair.decoder.decode(key)
    with pytest.raises(SettingsError, match="no setting") as refused:
        pair.encoder.apply(StreamSettings(codec="zstd", codec_settings={"nonsense": 1}))
    assert refused.value.field == "codec_settings.nonsense"
    assert pair.failures == []


@pytest.mark.sweep
def test_settings_and_codecs_change_within_the_process(ends):
    pair = ends()
    assert pair.encoder.encode(SCENES[0])
    pid = pair.sender.state()["pid"]
    assert pair.encoder.apply(LONG.changed(max_error_m=0.1)) in (True, False)
    (coarse,) = pair.encoder.encode(SCENES[1], key=True)
    assert abs(pair.decoder.decode(coarse)[0].range.astype(int) - SCENES[1].range).max() > 0
    assert pair.encoder.apply(StreamSettings(codec="jpeg-layered", codec_settings={"group": 4}))
    assert pair.encoder.encode(SCENES[2]) == []
    assert pair.encoder.apply(LONG) is True
    held, key = pair.encoder.encode(SCENES[3])  # what the group held back, then the new codec
    assert (held.codec, held.frame_index, key.codec, key.key) == (table.codec_id("jpeg-layered"), 2, 2, True)
    came = pair.decoder.decode(held) + pair.decoder.decode(key)
    assert [frame.index for frame in came] == [2, 3]
    assert pair.sender.state()["pid"] == pid


@pytest.mark.sweep
def test_rate_control_keeps_what_it_learned_through_a_crash(ends):
    pair = ends(StreamSettings(codec="zstd", target_kbps=2000, intensity="off"))
    for frame in SCENES[:6]:
        pair.encoder.encode(frame)
    before = pair.encoder.rate
    with contextlib.suppress(WorkerError):  # no frame is lost when it was hit while it took the next setting
        strike(pair.sender, signal.SIGSEGV, lambda: pair.encoder.encode(SCENES[6]))
    pair.encoder.encode(SCENES[7])
    assert [error.cause for error in pair.failures] == ["killed by SIGSEGV"]
    assert pair.encoder.rate["reachable_kbps"] == pytest.approx(before["reachable_kbps"], rel=0.5)


@pytest.mark.sweep
def test_a_storm_of_crashes_is_slowed_down_and_survived(ends):
    pair = ends()
    starts = []
    for _ in range(3):
        while not pair.sender.ready("zstd"):
            assert pair.sender.state()["state"] in ("resting", "running", "none")
        starts.append(time.monotonic())
        os.kill(pair.sender.state()["pid"], signal.SIGSEGV)
        assert eventually(lambda: len(pair.failures) == len(starts) or not pair.sender.ready("zstd", 0.0))
    assert starts[2] - starts[1] >= 0.25  # after the second failure; the first one costs no time
    assert pair.sender.rests
    with pytest.raises(WorkerError) as seen:
        pair.encoder.encode(SCENES[0])
    assert seen.value.resting
    while not pair.sender.ready("zstd"):
        pass
    assert pair.encoder.encode(SCENES[1])[0].key


def test_the_process_is_small_and_knows_no_secrets(ends, monkeypatch):
    """A codec that was taken over must find neither passwords nor a network library."""
    monkeypatch.setenv("LIDARCODEC_DATABASE_URL", "postgresql://user:password@host/db")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    pair = ends()
    pair.encoder.encode(SCENES[0])
    pid = pair.sender.state()["pid"]
    environment = Path(f"/proc/{pid}/environ").read_bytes()
    assert b"password" not in environment
    assert b"secret" not in environment
    assert "zenoh" not in Path(f"/proc/{pid}/maps").read_text()
    assert os.getpgid(pid) == pid
    assert resource.prlimit(pid, resource.RLIMIT_CORE)[0] == 0
    assert resource.prlimit(pid, resource.RLIMIT_AS)[0] == 2**31


def test_the_process_leaves_signals_of_a_group_to_its_stream(ends):
    pair = ends()
    pair.encoder.encode(SCENES[0])
    pid = pair.sender.state()["pid"]
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(pid, number)
    assert pair.encoder.encode(SCENES[1])[0].key is False
    assert pair.sender.state()["pid"] == pid


@pytest.mark.parametrize("busy", [False, True], ids=["idle", "stopped"])
def test_the_process_ends_with_a_stream_that_was_killed(busy):
    code = (
        "import os, time; from lidarcodec.apps.worker.isolation import Isolation\n"
        "one = Isolation('always', print); one.start('zstd')\n"
        "while not one.ready('zstd'): pass\n"
        "print(one.state()['pid'], flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        if busy:
            os.kill(pid, signal.SIGSTOP)
        parent.kill()
    if busy:
        os.kill(pid, signal.SIGCONT)
    assert eventually(lambda: gone(pid))


def test_an_unknown_choice_is_refused(monkeypatch):
    with pytest.raises(SettingsError, match="auto, always, never"):
        Isolation("sometimes", print)
    monkeypatch.setenv("LIDARCODEC_ISOLATE", "sometimes")
    with pytest.raises(SettingsError):
        Publisher(Loop(1))
    monkeypatch.setenv("LIDARCODEC_ISOLATE", "always")
    assert Isolation(None, print).isolated("raw")
