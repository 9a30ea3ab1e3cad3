"""What a user loses if these fail: a source opened as something else, or an error that does not say what to do."""

from __future__ import annotations

import itertools
import re
import threading
import time

import pytest

from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.sources import open_source
from lidarcodec.sources.pacing import PacedSource
from lidarcodec.sources.spec import parse
from tests.sources import captures as c
from tests.transport.test_contract import eventually


@pytest.fixture
def capture(tmp_path):
    path = tmp_path / "drive.pcap"
    path.write_bytes(c.pcap([c.frame(c.payload(k)) for k in range(40)], step_ns=10_000_000))
    return path


@pytest.mark.parametrize(
    ("text", "scheme", "place", "options"),
    [
        ("udp://0.0.0.0:2368", "udp", "0.0.0.0:2368", {}),
        ("udp://[::]:2368?any=1&src=fe80::1", "udp", "[::]:2368", {"any": "1", "src": "fe80::1"}),
        ("sim:city?seed=3&frames=10", "sim", "city", {"seed": "3", "frames": "10"}),
        ("sim:city", "sim", "city", {}),
        ("a/drive.pcap?port=2369", "", "a/drive.pcap", {"port": "2369"}),
        ("C:/drive.pcap", "", "C:/drive.pcap", {}),
    ],
)
def test_a_source_is_taken_apart_as_written(text, scheme, place, options):
    spec = parse(text)
    assert (spec.scheme, spec.place, spec.options) == (scheme, place, options)


def test_a_file_whose_name_looks_like_an_address_is_still_a_file(tmp_path, capture, monkeypatch):
    monkeypatch.chdir(tmp_path)
    capture.rename(tmp_path / "sim:drive?port=1")
    assert len(list(open_source("sim:drive?port=1").packets())) == 40


def test_errors_say_what_is_wrong(tmp_path, capture):
    with pytest.raises(UnknownNameError, match="unknown kind of source 'rtsp': choose one of a path, udp, ros2, sim"):
        open_source("rtsp://camera")
    with pytest.raises(UnknownNameError, match="'prot': did you mean port"):
        open_source(f"{capture}?prot=1")
    with pytest.raises(SourceError, match="port=many: write a number from 1 to 65535"):
        open_source(f"{capture}?port=many")
    with pytest.raises(SourceError, match=r"frames=0: write a number from 1 to 1000000000$"):
        open_source("sim:city?frames=0")
    with pytest.raises(SourceError, match=r"port=1.5: write a whole number"):
        open_source(f"{capture}?port=1.5")
    with pytest.raises(SourceError, match="does not exist"):
        open_source(tmp_path / "nothing.pcap")
    with pytest.raises(SourceError, match="no source given"):
        open_source("")
    with pytest.raises(SourceError, match="cannot read poses"):
        open_source(capture, poses=tmp_path / "nothing.npz")


def test_replay_keeps_the_sensors_own_pace(capture):
    def took_s() -> float:
        with open_source(capture, realtime=True, speed=2.0) as source:
            assert source.live
            start = time.monotonic()
            packets = list(source.packets())
            took = time.monotonic() - start
        assert len(packets) == 40
        assert took > 0.19  # 39 x 10 ms at twice the pace
        assert packets == list(open_source(capture).packets())
        return took

    assert eventually(lambda: took_s() < 0.38, 60), "at best, for the machine may be busy"


def test_replay_can_be_stamped_with_the_time_of_now(capture):
    with open_source(capture, realtime=True, speed=10.0, restamp=True) as source:
        before = time.time_ns()
        stamps = []
        for packet in source.packets():
            stamps.append(packet.stamp_ns)
            own_ns = packet.stamp_ns - source.shift_ns
        assert before <= stamps[0] <= stamps[-1] <= time.time_ns()
    assert own_ns == [p.stamp_ns for p in open_source(capture).packets()][-1]


def test_a_replay_that_cannot_keep_up_says_so_once_and_counts_its_late_packets(caplog):
    """A simulated VLS-128 took two seconds for each second of its drive, and nothing said why frames were rare."""
    with open_source("sim:room", realtime=True, speed=1e4) as source:
        given = list(itertools.takewhile(lambda _: source.counts["late packets"] < 10, source.packets()))
    assert len(given) > 10
    warnings = [record.getMessage() for record in caplog.records if record.name == "lidarcodec.sources.pacing"]
    assert len(warnings) == 1
    assert re.match(r"simulated room, seed 1: packets come \d+[.]\d s late, because this machine", warnings[0])


def test_a_loop_goes_on_with_rising_stamps_until_it_is_closed(capture):
    with open_source(capture, loop=True) as source:
        stamps = []
        for packet in source.packets():
            stamps.append(packet.stamp_ns)
            if len(stamps) == 100:
                source.close()
    assert len(stamps) == 100
    assert all(b > a for a, b in itertools.pairwise(stamps))


def test_close_ends_a_replay_that_waits(tmp_path):
    path = tmp_path / "slow.pcap"
    path.write_bytes(c.pcap([c.frame(c.payload(k)) for k in range(3)], step_ns=900_000_000))

    def ends_at_once() -> bool:
        source = open_source(path, realtime=True)
        threading.Timer(0.1, source.close).start()
        start = time.monotonic()
        return len(list(source.packets())) == 1 and time.monotonic() - start < 0.5

    assert eventually(ends_at_once, 60), "at best, for the machine may be busy"


def test_a_speed_of_nothing_is_refused(capture):
    for speed in (0.0, -1.0, float("nan")):
        with pytest.raises(SourceError, match="greater than 0"):
            PacedSource(open_source(capture), speed=speed)
