"""What a user loses if these fail: a source that cannot stand where any other does."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from lidarcodec.packet import Packet
from lidarcodec.sensors import generic_sensor
from lidarcodec.sources import open_source
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.spec import parse
from lidarcodec.sources.table import TABLE, kind_of
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Priority
from tests.bridges.test_ros_source import key
from tests.contracts import source as contract
from tests.point_clouds import STAMP_NS, message, velodyne
from tests.sources import captures as c
from tests.sources.test_kitti import drive, turn
from tests.sources.test_recording import record
from tests.sources.test_rosbag import bag
from tests.transport.conftest import free_port


@contextlib.contextmanager
def sensor(folder: Path) -> Iterator[str]:
    """A sensor that sends to this machine as long as anybody looks."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    stop = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            number = 0
            while not stop.wait(0.0005):
                number += 1
                sock.sendto(c.payload(number), ("127.0.0.1", port))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield f"udp://127.0.0.1:{port}?wait=0"
    finally:
        stop.set()
        thread.join()


@contextlib.contextmanager
def capture(folder: Path) -> Iterator[str]:
    (folder / "drive.pcap").write_bytes(c.pcap(c.frame(c.payload(k)) for k in range(100)))
    yield str(folder / "drive.pcap")


@contextlib.contextmanager
def kitti(folder: Path) -> Iterator[str]:
    yield str(drive(folder, [turn()[3]]))


@contextlib.contextmanager
def recording(folder: Path) -> Iterator[str]:
    yield str(record(folder / "drive.mcap"))


@contextlib.contextmanager
def rosbag(folder: Path) -> Iterator[str]:
    yield str(bag(folder / "bag.mcap"))


@contextlib.contextmanager
def town(folder: Path) -> Iterator[str]:
    yield "sim:city?seed=2&frames=2"


@contextlib.contextmanager
def topic(folder: Path) -> Iterator[str]:
    """A node that publishes clouds as long as anybody looks."""
    endpoint, stop = f"tcp/127.0.0.1:{free_port()}", threading.Event()
    with open_transport(Endpoints.of(listen=endpoint, mode="router")) as router:
        sender, cloud = router.sender(key(), Priority.EVERY_FRAME), velodyne(20)

        def send() -> None:
            stamp_ns = STAMP_NS
            while not stop.wait(0.005):
                stamp_ns += 5_000_000
                sender.put(message(cloud, stamp_ns=stamp_ns))

        node = threading.Thread(target=send)
        node.start()
        try:
            yield f"ros2:/lidar/points?router={endpoint}"
        finally:
            stop.set()
            node.join()


EXAMPLES = {
    "rosbag": rosbag,
    "capture": capture,
    "udp": sensor,
    "ros2": topic,
    "folder": kitti,
    "recording": recording,
    "sim": town,
}


def test_every_line_of_the_table_has_an_example_here():
    assert set(EXAMPLES) == set(TABLE)


@pytest.mark.parametrize("kind", TABLE)
@pytest.mark.parametrize("check", contract.CHECKS, ids=lambda check: check.__name__)
def test_every_source(tmp_path, kind, check):
    with EXAMPLES[kind](tmp_path) as spec:
        assert kind_of(parse(spec)) == kind
        check(lambda: open_source(spec))


@pytest.mark.parametrize("kind", TABLE)
def test_every_replayed_source(tmp_path, kind):
    with EXAMPLES[kind](tmp_path) as spec:
        for check in contract.CHECKS:
            check(lambda: open_source(spec, realtime=True, speed=20.0))


@pytest.mark.parametrize("kind", TABLE)
def test_options_and_places_that_do_not_exist(tmp_path, kind):
    with EXAMPLES[kind](tmp_path) as spec:
        contract.refuses_options_it_lacks(spec)
    contract.says_when_there_is_nothing(
        {"udp": "udp://192.0.2.1:1", "sim": "sim:moon"}.get(kind, f"{tmp_path}/nothing")
    )


class Wrong(PacketSource):
    """A source that stops at nothing, gives nonsense, and something else each time."""

    def __init__(self) -> None:
        super().__init__(generic_sensor())
        self.number = 0

    def packets(self) -> Iterator[Packet]:
        while self.number < 2000:
            self.number += 1
            yield Packet(bytes(1205), -self.number)


@pytest.mark.parametrize("check", contract.CHECKS, ids=lambda check: check.__name__)
def test_a_wrong_source_fails_every_check(check):
    with pytest.raises(AssertionError):
        check(Wrong)
