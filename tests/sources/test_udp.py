"""What a user loses if these fail: live packets lost in silence, another sensor mixed in, or a program that hangs."""

from __future__ import annotations

import contextlib
import logging
import socket
import struct
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from lidarcodec import _native
from lidarcodec.errors import PacketError, SettingsError, SourceError, UnknownNameError
from lidarcodec.sensors import generic_sensor, status_bytes
from lidarcodec.sources import open_source
from lidarcodec.sources.udp import socket as udp_socket
from lidarcodec.sources.udp import source as udp
from lidarcodec.sources.udp.source import UdpSource
from tests.sources import captures as c
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

PAYLOADS = [c.payload(k) for k in range(500)]


@contextlib.contextmanager
def sending(source: UdpSource, host: str = "127.0.0.1", family: int = socket.AF_INET):
    """A function that sends payloads to the source, from an address of its own."""
    with socket.socket(family, socket.SOCK_DGRAM) as sock:
        sock.bind((host, 0))
        target = ("::1" if family == socket.AF_INET6 else "127.0.0.1", source.address[1])

        def send(*payloads: bytes) -> None:
            for payload in payloads:
                sock.sendto(payload, target)

        yield send


def take(source: UdpSource, count: int) -> list:
    """The first `count` packets."""
    found = []
    for packet in source.packets():
        found.append(packet)
        if len(found) == count:
            break
    return found


def test_packets_arrive_in_order_with_the_hosts_time():
    with open_source("udp://127.0.0.1:0?wait=0") as source, sending(source) as send:
        before = time.time_ns()
        send(*PAYLOADS)
        packets = take(source, len(PAYLOADS))
    assert [p.payload for p in packets] == PAYLOADS
    stamps = [p.stamp_ns for p in packets]
    assert before <= stamps[0]
    assert stamps == sorted(stamps)
    assert stamps[-1] <= time.time_ns()
    assert source.live
    assert not source.counts


def test_wrong_lengths_and_strangers_are_counted_never_delivered():
    with (
        open_source("udp://0.0.0.0:0?wait=0") as source,
        sending(source) as send,
        sending(source, "127.0.0.2") as other,
    ):
        send(bytes(10), b"", bytes(1205), bytes(1207), bytes(9000), bytes(512), PAYLOADS[0])
        assert take(source, 1)[0].payload == PAYLOADS[0]
        other(*PAYLOADS[1:5])
        send(PAYLOADS[5])
        assert take(source, 1)[0].payload == PAYLOADS[5]
    assert dict(source.counts) == {"wrong length": 5, "position packets not kept": 1, "strangers": 4}


def test_the_sender_can_be_chosen_or_left_open():
    with open_source("udp://0.0.0.0:0?wait=0&src=127.0.0.2") as source, sending(source) as send:
        with sending(source, "127.0.0.2") as other:
            send(PAYLOADS[0])
            other(PAYLOADS[1])
            assert take(source, 1)[0].payload == PAYLOADS[1]
        assert source.counts["strangers"] == 1
    with (
        open_source("udp://0.0.0.0:0?wait=0&any=1") as source,
        sending(source) as send,
        sending(source, "127.0.0.2") as other,
    ):
        send(PAYLOADS[0])
        other(PAYLOADS[1])
        assert {p.payload for p in take(source, 2)} == set(PAYLOADS[:2])


def test_a_sensor_that_is_not_known_is_refused_by_name_but_does_not_stop_the_right_one():
    velarray = (struct.pack("<HH", 0xEEFF, 0) + bytes(96)) * 12 + bytes(4) + b"\x37\x31"
    with (
        open_source("udp://0.0.0.0:0?wait=0") as source,
        sending(source, "127.0.0.2") as other,
        sending(source) as send,
    ):
        send(*PAYLOADS[:40])
        other(*[velarray] * 100)
        send(*PAYLOADS[40:80])
        assert [packet.payload for packet in take(source, 80)] == PAYLOADS[:80]
    assert source.counts["strangers"] == 100
    with open_source("udp://127.0.0.1:0?wait=0") as source, sending(source) as send:
        send(*[velarray] * 70)
        with pytest.raises(PacketError, match="Velarray"):
            list(source.packets())


def test_packets_the_kernel_dropped_are_counted(monkeypatch, caplog):
    def late(*args, **options):
        """A socket that nobody reads for a while."""
        sock = udp_socket.open_socket(*args, **options)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.bind(("127.0.0.1", 0))
            for payload in PAYLOADS:
                sender.sendto(payload, sock.getsockname())
        return sock

    monkeypatch.setattr(udp_socket, "BUFFER_BYTES", 50_000)
    monkeypatch.setattr(udp, "open_socket", late)
    with open_source("udp://127.0.0.1:0?wait=0&idle=0.3") as source, sending(source) as send:
        assert "raise net.core.rmem_max" in caplog.text
        received = list(source.packets())
        send(PAYLOADS[0])  # the kernel says with the next packet what it dropped before
        assert eventually(lambda: received.extend(source.packets()) or source.counts["strangers"], 60)
    assert 5 < len(received) < 200
    assert source.counts["strangers"] == 1  # another port is another sender
    assert source.counts["kernel drops"] == len(PAYLOADS) + 1 - len(received) - source.counts["strangers"]


def test_a_queue_that_is_full_loses_the_oldest_and_counts_them(monkeypatch):
    monkeypatch.setattr(udp, "QUEUE_PACKETS", 100)
    with open_source("udp://127.0.0.1:0?wait=0&idle=0.1") as source, sending(source) as send:
        send(*PAYLOADS)
        assert eventually(lambda: source._receiver.counts()[1] == 400, 60)
        assert [p.payload for p in source.packets()] == PAYLOADS[400:]
    assert source.counts["queue drops"] == 400


def test_nothing_is_lost_beside_busy_threads():
    """A second of an HDL-64 at its own pace, while two threads hold the interpreter."""
    stop = threading.Event()

    def burn() -> None:
        while not stop.is_set():
            sum(range(20_000))

    threads = [threading.Thread(target=burn) for _ in range(2)]
    with open_source("udp://127.0.0.1:0?wait=0&idle=20") as source, sending(source) as send:
        for thread in threads:
            thread.start()
        try:
            start = time.monotonic()
            for number in range(3472):
                ahead = start + number * 288e-6 - time.monotonic()
                if ahead > 0.002:
                    time.sleep(ahead)
                send(PAYLOADS[number % 500])
            received = len(take(source, 3472))
        finally:
            stop.set()
            for thread in threads:
                thread.join()
    assert received == 3472
    assert not source.counts


@pytest.mark.parametrize("reading", [True, False])
def test_close_from_another_thread_ends_it_promptly(reading):
    def takes_s() -> float:
        source = open_source("udp://127.0.0.1:0?wait=0")
        thread = threading.Thread(target=lambda: list(source.packets()))
        if reading:
            thread.start()
        time.sleep(0.05)
        start = time.monotonic()
        source.close()
        source.close()
        if reading:
            thread.join(60)
            assert not thread.is_alive()
        took_s = time.monotonic() - start
        assert list(source.packets()) == []
        return took_s

    assert eventually(lambda: takes_s() < 0.2, 60), "at best, for the machine may be busy"


def test_an_address_is_free_again_after_close():
    with open_source("udp://127.0.0.1:0?wait=0") as source:
        port = source.address[1]
    open_source(f"udp://127.0.0.1:{port}?wait=0").close()


def test_an_idle_time_limit_ends_it():
    with open_source("udp://127.0.0.1:0?wait=0&idle=0.05") as source, sending(source) as send:
        assert list(source.packets()) == []
        send(PAYLOADS[0])
        came: list = []
        assert eventually(lambda: came.extend(source.packets()) or came, 60)
        assert len(came) == 1


def test_that_nothing_comes_is_said_once_and_for_how_long_it_is_waited(monkeypatch, caplog):
    """Every command that reads a live sensor waited without a word."""
    monkeypatch.setattr(udp, "SAY_S", 0.1)
    with open_source("udp://127.0.0.1:0?wait=0&idle=1.5") as source:
        assert list(source.packets()) == []
        (said,) = [line for line in caplog.messages if "no packet arrived" in line]
        assert f"port {source.address[1]}" in said
        assert "1.5 s" in said
    caplog.clear()
    with open_source("udp://127.0.0.1:0?wait=0") as source, sending(source) as send:
        threading.Timer(1.0, send, PAYLOADS).start()
        assert len(take(source, 500)) == 500
    (said,) = [line for line in caplog.messages if "no packet arrived" in line]
    assert "Ctrl-C" in said
    assert "?idle=" in said


def test_a_multicast_group_is_joined():
    with (
        open_source("udp://239.255.77.7:0?wait=0&interface=127.0.0.1") as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        sock.sendto(PAYLOADS[0], ("239.255.77.7", source.address[1]))
        assert take(source, 1)[0].payload == PAYLOADS[0]


def test_ipv6():
    try:
        source = open_source("udp://[::1]:0?wait=0&src=::1")
    except SourceError as error:
        pytest.skip(f"no IPv6 here: {error}")
    with source, sending(source, "::1", socket.AF_INET6) as send:
        send(PAYLOADS[0])
        assert take(source, 1)[0].payload == PAYLOADS[0]


def with_status(rows: np.ndarray) -> list[bytes]:
    return [c.payload(k)[:1204] + rows[k % len(rows)].tobytes() for k in range(len(rows) + 16)]


def test_the_sensors_own_calibration_is_found_while_it_is_opened_and_no_packet_is_lost():
    sensor = generic_sensor("HDL-64E S2")
    payloads = with_status(status_bytes(sensor))
    port = free_port()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            eventually(lambda: f":{port:04X} " in Path("/proc/net/udp").read_text(), 60)
            for number, payload in enumerate(payloads):
                sock.sendto(payload, ("127.0.0.1", port))
                if number % 50 == 0:
                    time.sleep(0.001)

    thread = threading.Thread(target=send)
    thread.start()
    with open_source(f"udp://127.0.0.1:{port}?wait=60", convention="veloview") as source:
        thread.join()
        assert source.sensor.origin == "stream"
        assert source.sensor.convention == "veloview"
        turn = [s.calibration["rot_correction_rad"] for s in (source.sensor, sensor)]
        assert np.abs(turn[0] - turn[1]).max() < 1e-4  # sent in steps of 0.01 degree
        assert [p.payload for p in take(source, len(payloads))] == payloads


def test_a_calibration_that_comes_late_replaces_the_generic_one(caplog):
    payloads = with_status(status_bytes(generic_sensor("HDL-64E S2")))
    with caplog.at_level(logging.INFO), open_source("udp://127.0.0.1:0?wait=0.01") as source, sending(source) as send:
        assert source.sensor.origin == "generic"
        coming = source.packets()
        for start in range(0, len(payloads), 100):  # no more than any receive buffer holds
            some = payloads[start : start + 100]
            send(*some)
            assert [bytes(next(coming).payload) for _ in some] == [bytes(one) for one in some]
        assert source.sensor.origin == "stream"
        assert "from the sensor's status bytes" in caplog.text


def test_without_a_table_in_the_stream_opening_does_not_wait():
    port = free_port()
    stop = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            while not stop.wait(0.001):
                sock.sendto(PAYLOADS[0], ("127.0.0.1", port))

    thread = threading.Thread(target=send)
    thread.start()
    start = time.monotonic()
    try:
        with open_source(f"udp://127.0.0.1:{port}?wait=60"):
            assert time.monotonic() - start < 20.0
    finally:
        stop.set()
        thread.join()


def test_addresses_that_cannot_be_listened_on_say_why():
    for spec, match in (
        ("udp://192.0.2.1:2368", "0.0.0.0 listens on all"),
        ("udp://no.such.host.invalid:2368", "no such host"),
        ("udp://127.0.0.1:70000", "a number up to 65535"),
        ("udp://127.0.0.1:port", "a number up to 65535"),
        ("udp://127.0.0.1:0?src=me", "an IP address"),
        ("udp://127.0.0.1:0?idle=-1", "idle=-1: write a number from"),
        ("udp://127.0.0.1:0?any=perhaps", "1 or 0"),
    ):
        with pytest.raises(SourceError, match=match):
            open_source(spec)
    with pytest.raises(UnknownNameError, match="'prot'"):
        open_source("udp://127.0.0.1:0?prot=1")
    with (
        open_source("udp://127.0.0.1:0?wait=0") as source,
        pytest.raises(SourceError, match=r"another program \(add \?share=1"),
    ):
        open_source(f"udp://127.0.0.1:{source.address[1]}")
    with open_source("udp://127.0.0.1:0?wait=0&share=1") as source:
        open_source(f"udp://127.0.0.1:{source.address[1]}?wait=0&share=1").close()


def test_a_receiver_without_a_socket_or_a_ring_is_refused():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for capacity in (0, 2**20 + 1):
            with pytest.raises(SettingsError, match="1 to 1048576"):
                _native.UdpReceiver(sock.fileno(), capacity)
    with pytest.raises(SettingsError, match="no socket"):
        _native.UdpReceiver(987_654, 100)


def test_a_wrong_model_is_reported_once(caplog):
    with open_source("udp://127.0.0.1:0?wait=0&model=vlp16") as source, sending(source) as send:
        send(*PAYLOADS[:200])
        assert len(take(source, 200)) == 200
    assert caplog.text.count("--model says vlp16, but") == 1
