"""The sensor's own UDP stream at the far end: an unchanged driver must see the same bytes at the same pace."""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.apps.receiver.udp_out import UdpOut, address_of, due_s, target_of
from lidarcodec.assembly import Assembler, packets_of
from lidarcodec.errors import SettingsError, TransportError
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.sources import open_source
from lidarcodec.transport.memory import MemoryNetwork
from tests.apps.streams import Loop
from tests.calm import when_calm
from tests.packets import packets_in
from tests.positions import interleaved
from tests.transport.test_contract import eventually

SO_RCVBUFFORCE = 33
"""Of Linux, and not in the standard library."""


class Driver:
    """A socket that takes what a sensor sends, and when."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
        with contextlib.suppress(OSError):  # beyond the system's limit, for those who may
            self._socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 8 << 20)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.1)
        self.address = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self.payloads: list[bytes] = []
        self.times: list[float] = []
        self.senders: set = set()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                data, sender = self._socket.recvfrom(65_536)
            except TimeoutError:
                continue
            self.times.append(time.monotonic())
            self.payloads.append(data)
            self.senders.add(sender)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()


@pytest.fixture
def driver():
    one = Driver()
    yield one
    one.close()


@contextlib.contextmanager
def both_ends() -> Iterator[tuple[UdpOut, Driver]]:
    """What sends, and what takes it."""
    driver = Driver()
    out = UdpOut(driver.address)
    out.start()
    try:
        yield out, driver
    finally:
        out.close()
        driver.close()


@pytest.fixture
def udp(driver):
    out = UdpOut(driver.address)
    out.start()
    yield out
    out.close()


def frames_of(count: int, first: int = 0) -> list[Frame]:
    source = Loop(count, first=first)
    assembler = Assembler(source.sensor, "packets")
    return [frame for packet in source.packets() if (frame := assembler.push(packet)) is not None]


def at_the_pace_of_the_sensor() -> None:
    with both_ends() as (udp, driver):
        leaves_as_it_came(udp, driver)


def test_packets_leave_as_they_came_and_at_the_pace_of_the_sensor():
    when_calm(at_the_pace_of_the_sensor, 0.02)


def leaves_as_it_came(udp, driver):
    frames = frames_of(5)
    begin = time.monotonic()
    for number, frame in enumerate(frames):
        time.sleep(max(0.0, begin + 0.1 * number - time.monotonic()))
        udp.put(frame)
    assert udp.wait_sent(60)
    assert eventually(lambda: len(driver.payloads) == 5 * 348)
    assert driver.payloads == Loop(5).payloads()
    assert len(driver.senders) == 1
    assert dict(udp.counts) == {"frames": 5, "packets": 5 * 348}
    due = np.arange(5 * 348) * 288e-6
    error = np.array(driver.times) - driver.times[0] - due
    assert np.ptp(error) < 0.15  # of 500 ms; a busy machine wakes threads late
    assert np.median(np.abs(np.diff(driver.times[::29]) - 29 * 288e-6)) < 0.003


def test_the_newest_wins_when_frames_come_too_fast(udp, driver):
    for frame in frames_of(30):
        udp.put(frame)
    assert udp.wait_sent(60)
    assert udp.counts["replaced"] > 15
    assert eventually(lambda: len(driver.payloads) == udp.counts["packets"])
    assert driver.payloads[-1] == Loop(1, first=29).payloads()[-1]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what became of a packet")
def test_packets_that_nobody_takes_are_told_and_all_come_once_somebody_listens(caplog):
    driver = Driver()
    driver.close()
    out = UdpOut(driver.address)
    out.start()
    first, second = frames_of(2)
    out.put(first)
    assert out.wait_sent(60)
    assert out.counts["refused"] > 0
    assert f"nobody takes packets at 127.0.0.1, port {driver.address.partition(':')[2]}" in caplog.text
    host, _, port = driver.address.partition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taker:
        taker.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
        taker.bind((host, int(port)))
        taker.settimeout(5.0)
        out.put(second)
        assert out.wait_sent(60)
        assert [taker.recv(65_536) for _ in packets_of(second)] == [bytes(one.payload) for one in packets_of(second)]
    out.close()


def test_it_catches_up_after_the_path_was_slow_for_a_moment():
    """One frame comes 80 ms late; two seconds of undisturbed frames later the delay must be what it was."""

    def check() -> None:
        with both_ends() as (udp, driver):
            catches_up(udp, driver)

    when_calm(check, 0.01)


def catches_up(udp, driver):
    delays = {}
    frames = frames_of(40)
    begin = time.monotonic()
    for number, frame in enumerate(frames):
        time.sleep(max(0.0, begin + 0.1 * number + (0.08 if number == 5 else 0.0) - time.monotonic()))
        udp.put(frame)
    assert udp.wait_sent(60)
    assert eventually(lambda: len(driver.payloads) == 40 * 348)
    for number in (3, 7, 39):
        delays[number] = driver.times[348 * number] - begin - 0.1 * number
    assert delays[7] > 0.075
    assert delays[39] < delays[7] - 0.02
    assert udp.counts["replaced"] == 0


def test_a_new_stream_begins_at_once_whatever_its_stamps(udp, driver):
    for number, frame in enumerate((*frames_of(1), *frames_of(1, first=100_000), *frames_of(1)), 1):
        udp.put(frame)
        assert udp.wait_sent(60)
        assert eventually(lambda number=number: len(driver.payloads) == number * 348)
    assert udp.counts["late"] == 2


def test_a_frame_that_never_was_packets_is_counted_and_the_next_one_leaves(udp, driver):
    (frame,) = frames_of(1)
    udp.put(frame.with_(side=None))
    udp.put(frame)
    assert eventually(lambda: len(driver.payloads) == 348)
    assert udp.counts["no packets"] == 1


def test_closing_ends_a_frame_in_the_middle(driver):
    def ends_in_the_middle() -> bool:
        out = UdpOut(driver.address)
        out.start()
        out.put(frames_of(1)[0])
        time.sleep(0.05)
        start = time.monotonic()
        out.close()
        return time.monotonic() - start < 0.5 and out.counts["packets"] < 348

    assert eventually(ends_in_the_middle), "at best, for the machine may be busy"


@pytest.mark.parametrize(
    "text", ["", ":2368", "host:", "host:0", "host:70000", "host:x", "::1:2368", "host:\u00b2", "host:\u0663"]
)
def test_an_address_that_is_none_is_refused(text):
    with pytest.raises(SettingsError):
        address_of(text)


@pytest.mark.parametrize("port", ["", "0", "70000", "x", "\u00b2", "9" * 5000])
def test_a_port_for_position_packets_that_is_none_is_refused(port):
    with pytest.raises(SettingsError):
        target_of(f"127.0.0.1:2368?position={port}")


def test_addresses_of_both_kinds_and_the_sensor_s_port_by_default():
    assert address_of("127.0.0.1") == (socket.AF_INET, ("127.0.0.1", 2368))
    assert address_of("[::1]:7000") == (socket.AF_INET6, ("::1", 7000))
    with pytest.raises(TransportError):
        address_of("no-such-host.invalid:2368")


def test_the_position_port_is_the_usual_one_beside_the_sensor_s_port_and_can_be_named():
    assert target_of("127.0.0.1").position == ("127.0.0.1", 8308)
    assert target_of("127.0.0.1:7502").position == ("127.0.0.1", 7503), "of an Ouster's inertial unit"
    assert target_of("127.0.0.1:2369").position is None
    assert target_of("127.0.0.1:2369?position=8309").position == ("127.0.0.1", 8309)
    assert target_of("127.0.0.1:2368?position=off").position is None
    assert target_of("[::1]:7000?position=7001").position == ("::1", 7001)
    for text in ("127.0.0.1?position=0", "127.0.0.1?position=", "127.0.0.1?port=7", "127.0.0.1?"):
        with pytest.raises(SettingsError, match="position"):
            target_of(text)


def with_positions() -> Frame:
    """A turn with position packets."""
    assembler = Assembler(Loop(1).sensor, "packets:348")
    (frame,) = [frame for packet in interleaved(Loop(1).packets()) if (frame := assembler.push(packet))]
    return frame


def test_position_packets_leave_at_their_place_to_their_port():
    when_calm(leave_at_their_place, 0.02)


def leave_at_their_place() -> None:
    with contextlib.closing(Driver()) as driver, contextlib.closing(Driver()) as other:
        positions_leave(driver, other)


def positions_leave(driver: Driver, other: Driver) -> None:
    frame = with_positions()
    out = UdpOut(f"{driver.address}?position={other.address.rpartition(':')[2]}")
    out.start()
    out.put(frame)
    sent = packets_of(frame)
    assert eventually(lambda: len(driver.payloads) == 348 and len(other.payloads) == len(sent) - 348 == 25)
    out.close()
    assert driver.payloads == [packet.payload for packet in sent if not packet.position]
    assert other.payloads == [packet.payload for packet in sent if packet.position]
    assert driver.senders == other.senders
    assert dict(out.counts) == {"frames": 1, "packets": 348, "position packets": 25}
    assert (np.diff(due_s(frame.side)) >= 0).all()
    half = driver.times[174]
    assert 6 <= sum(at < half for at in other.times) <= 19, "between the data packets, not before or behind them"


def test_position_packets_without_a_port_are_counted_and_said_once(udp, driver, caplog):
    udp.put(with_positions())
    assert eventually(lambda: len(driver.payloads) == 348)
    assert eventually(lambda: udp.counts["position packets not sent"] == 25)
    assert caplog.text.count("position packets not sent") == 1


def clouds(packets: list[Packet]):
    """Clouds of an independent decoder."""
    import velodyne_decoder as vd

    config = vd.Config(model=vd.Model.HDL64E_S2, calibration=vd.get_bundled_calibration("HDL-64E_S2.1-sztaki.yml"))
    decoder = vd.StreamDecoder(config)
    found = []
    for packet in packets:
        scan = decoder.decode(packet.stamp_ns / 1e9, packet.payload, False)
        if scan is not None:
            found.append(np.asarray(scan[1]))
    return found


@pytest.mark.data
def test_an_independent_decoder_sees_the_same_clouds_in_what_a_subscriber_re_emits(data_file, driver):
    pytest.importorskip("velodyne_decoder")
    capture = data_file("kitti_tracking0006_f000-010.pcap.xz")
    packets = packets_in(capture)
    network = MemoryNetwork()
    with (
        network.transport() as near,
        network.transport() as far,
        subscribe("vehicle/lidar", transport=far, udp=driver.address, newest=False, until_end=True) as stream,
        open_source(capture) as source,
    ):
        with Publisher(source, transport=near, rate="max"):
            for _ in stream:
                pass
        sent = stream.summary()["udp"]
        sent.pop("late", 0)  # a machine that stands still for half a second starts the timing afresh
        assert sent == {"frames": 11, "packets": len(packets)}
        assert eventually(lambda: len(driver.payloads) == len(packets))
    assert driver.payloads == [packet.payload for packet in packets]
    again = [Packet(data, packet.stamp_ns) for data, packet in zip(driver.payloads, packets, strict=True)]
    before, after = clouds(packets), clouds(again)
    assert len(before) == len(after) > 5
    for one, other in zip(before, after, strict=True):
        assert len(one) > 50_000
        np.testing.assert_array_equal(one, other)
