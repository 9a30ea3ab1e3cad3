"""Position packets from every source: in order, with their host times, and what is not kept is said."""

from __future__ import annotations

import io
import socket
import struct
import time
from collections import Counter
from ipaddress import ip_address

import pytest

from lidarcodec.errors import SectionError, SourceError, TruncatedError
from lidarcodec.packet import Packet, data_packets
from lidarcodec.recording import RecordingWriter
from lidarcodec.recording.layout import pack_batch, unpack_batch
from lidarcodec.sources import open_source, unkept
from lidarcodec.sources.captures.pcap import Ending
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from lidarcodec.sources.captures.source import stamped_datagrams
from lidarcodec.sources.udp.positions import PositionListener
from lidarcodec.sources.udp.socket import SO_TIMESTAMPNS
from lidarcodec.units import DATA_PORT, POSITION_PORT
from tests.packets import packets_in
from tests.positions import interleaved, position
from tests.sources import captures as c
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

DATA = [Packet(c.payload(k), c.T0_NS // 1000 * 1000 + k * 288_000) for k in range(200)]
MIXED = [*interleaved(DATA, every=9, first=0), position(DATA[-1].stamp_ns + 5000)]


def written(packets: list[Packet]) -> bytes:
    file = io.BytesIO()
    PcapWriter(file).write_all(packets)
    return file.getvalue()


@pytest.fixture
def capture(tmp_path):
    path = tmp_path / "mixed.pcap"
    path.write_bytes(written(MIXED))
    return path


def test_a_capture_gives_them_in_order_and_they_are_written_to_their_port(capture):
    with open_source(capture) as source:
        assert list(source.packets()) == MIXED
    assert source.counts == {"position packets": 24}
    ports = [datagram.port for _, datagram in stamped_datagrams(capture, Counter(), Ending())]
    assert ports == [POSITION_PORT if packet.position else DATA_PORT for packet in MIXED]


def test_options_say_which_are_position_packets(capture):
    with open_source(f"{capture}?position=off") as source:
        assert list(source.packets()) == DATA
        assert source.counts == {"position packets to another port": 24}
    assert packets_in(f"{capture}?position=8309") == DATA
    for text in ("0", "on", "70000"):
        with pytest.raises(SourceError, match="position"):
            open_source(f"{capture}?position={text}")


def test_those_of_another_sender_or_too_long_are_counted(tmp_path):
    frames = [c.frame(packet.payload) for packet in DATA[:20]]
    frames += [c.frame(bytes(512), source=c.OTHER, port=8308), c.frame(bytes(1473), port=8308)]
    frames += [c.frame(bytes(90), port=8308), c.frame(bytes(90), port=5353)]
    path = tmp_path / "others.pcap"
    path.write_bytes(c.pcap(frames))
    with open_source(path) as source:
        assert [p.payload for p in source.packets() if p.position] == [bytes(90)]
    assert source.counts == {
        "position packets": 1, "position packets not kept": 1, "wrong length": 1, "other datagrams": 1
    }  # fmt: skip
    assert unkept.unkept(source.counts).count(",") == 2


@pytest.mark.parametrize("packets", [MIXED, MIXED[:1], MIXED[-1:], DATA[:5], [MIXED[0], MIXED[0], DATA[0]]])
def test_a_batch_of_recorded_packets_has_them(packets):
    assert unpack_batch(pack_batch(packets)) == packets


@pytest.mark.parametrize("wrong", [b"", bytes(4), bytes(12), bytes(13), b"\1" + bytes(1216)])
def test_damaged_batches_are_refused(wrong):
    with pytest.raises((SectionError, TruncatedError)):
        unpack_batch(wrong)


def test_a_recording_of_packets_gives_them_back(tmp_path):
    path = tmp_path / "packets.mcap"
    with path.open("wb") as file, RecordingWriter(file, "truck", "roof") as writer:
        writer.write_packets(MIXED[:70])
        writer.write_packets(MIXED[70:])
    with open_source(path) as source:
        assert list(source.packets()) == MIXED
        assert source.counts == {"position packets": 24}


def test_a_replay_gives_them_at_their_place(capture):
    with open_source(capture, realtime=True, speed=1000.0, loop=True, restamp=True) as source:
        came = []
        for packet in source.packets():
            came.append(packet)
            if len(came) == 2 * len(MIXED):
                break
    assert [(p.payload, p.position) for p in came] == [(p.payload, p.position) for p in MIXED * 2]
    assert [p.stamp_ns for p in came] == sorted(p.stamp_ns for p in came)


def test_one_that_is_late_does_not_hold_up_a_replay(tmp_path):
    late = [packet if k % 9 else position(packet.stamp_ns - 500_000_000) for k, packet in enumerate(DATA)]
    path = tmp_path / "late.pcap"
    path.write_bytes(written([DATA[0], *late]))
    begin = time.monotonic()
    with open_source(path, realtime=True) as source:
        assert len(list(source.packets())) == 201
    assert time.monotonic() - begin < 8.0  # 58 ms, and not 23 times 500 more


def arrivals_are_stamped() -> bool:
    """Linux begins to stamp arrivals a moment after it was asked to; until then it stamps when they are read."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        probe.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        begin_ns = time.time_ns()
        probe.sendto(b"", probe.getsockname())
        time.sleep(0.02)
        seconds, ns = struct.unpack("@qq", probe.recvmsg(1, 64)[1][0][2])
        return seconds * 10**9 + ns < begin_ns + 15_000_000


def test_a_live_sensor_gives_them_by_the_time_of_arrival():
    port = free_port()
    with (
        open_source(f"udp://127.0.0.1:0?wait=0&idle=0.5&position={port}") as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor,
    ):
        assert eventually(arrivals_are_stamped, 60)
        for packet in MIXED:
            sensor.sendto(packet.payload, ("127.0.0.1", port if packet.position else source.address[1]))
        came: list[Packet] = []
        assert eventually(lambda: came.extend(source.packets()) or len(came) >= len(MIXED), 60)
    assert [(p.payload, p.position) for p in came] == [(p.payload, p.position) for p in MIXED]
    assert [p.stamp_ns for p in came] == sorted(p.stamp_ns for p in came)
    assert source.counts == {"position packets": 24}


def test_each_family_of_sensors_has_its_usual_port_beside_its_usual_data_port(monkeypatch):
    from lidarcodec.sources.udp import positions

    asked: list[int] = []
    monkeypatch.setattr(positions, "PositionListener", lambda host, port, **options: asked.append(port))
    for data_port in (2368, 7502, 2369):
        positions.listener_beside("127.0.0.1", data_port, None, interface=None, share=False)
    assert asked == [8308, 7503], "of a Velodyne's receiver, and of an Ouster's inertial unit"


def test_those_of_strangers_and_too_long_ones_are_counted():
    port = free_port()
    with (
        open_source(f"udp://0.0.0.0:0?wait=0&idle=0.3&position={port}") as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        assert eventually(arrivals_are_stamped, 60)
        stranger.bind(("127.0.0.2", 0))
        stranger.sendto(bytes(512), ("127.0.0.1", port))
        sensor.sendto(bytes(1473), ("127.0.0.1", port))
        sensor.sendto(MIXED[0].payload, ("127.0.0.1", port))
        sensor.sendto(DATA[0].payload, ("127.0.0.1", source.address[1]))
        came: list[Packet] = []
        assert eventually(lambda: came.extend(source.packets()) or len(came) >= 2, 60)
    assert [p.position for p in came] == [True, False]
    assert source.counts == {"position packets": 1, "strangers": 1, "wrong length": 1}


def test_a_port_that_is_taken_is_a_warning_and_one_that_was_named_an_error(monkeypatch, caplog):
    from lidarcodec.sources.udp import positions

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        monkeypatch.setattr(positions, "POSITION_PORTS", {1: port})
        options = {"interface": None, "share": False}
        assert positions.listener_beside("127.0.0.1", 1, None, **options) is None
        assert f"cannot be received: cannot listen on udp://127.0.0.1:{port}" in caplog.text
        with pytest.raises(SourceError, match="in use"):
            positions.listener_beside("127.0.0.1", 1, port, **options)
        assert positions.listener_beside("127.0.0.1", 1, 0, **options) is None
        assert positions.listener_beside("127.0.0.1", 2, None, **options) is None


def test_nothing_waits_without_end_while_no_sensor_is_known():
    port = free_port()
    listener = PositionListener("127.0.0.1", port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(2500):
            sender.sendto(MIXED[0].payload, ("127.0.0.1", port))
        assert listener.among([], None) == []
        assert len(listener._waiting) == 2048
        assert len(listener.among([], socket.inet_aton("127.0.0.1"))) == 2048
    listener.close()
    listener.close()
    assert list(data_packets(listener.among(DATA[:2], b"", anybody=True))) == DATA[:2]


def test_a_clock_that_is_set_back_holds_up_no_position_packets() -> None:
    """One that came behind the last data packet, by the clock of before, was "in the future" for an hour."""
    listener = PositionListener("127.0.0.1", 0)
    me, hour_ns = bytes([127, 0, 0, 9]), 3_600_000_000_000
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        sensor.bind(("127.0.0.9", 0))
        sensor.connect(listener._socket.getsockname()[:2])
        sensor.send(bytes(512))
        assert not [
            one for one in listener.among([Packet(bytes(1206), time.time_ns() - 5_000_000)], me) if one.position
        ]
        listener._waiting.extend((Packet(bytes(512), time.time_ns() - hour_ns, position=True), me) for _ in range(3))
        given = listener.among([Packet(bytes(1206), time.time_ns() - hour_ns + 5_000_000)], me)
    listener.close()
    assert sum(one.position for one in given) == 4
    assert not given[-1].position


def test_strangers_are_warned_of_while_the_source_runs(caplog):
    port = free_port()
    with (
        open_source(f"udp://0.0.0.0:0?wait=0&idle=20&position={port}") as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        stranger.bind(("127.0.0.2", 0))
        came, packets = 0, source.packets()
        until = time.monotonic() + 60
        while "refused" not in caplog.text and time.monotonic() < until:
            stranger.sendto(bytes(512), ("127.0.0.1", port))
            sensor.sendto(DATA[0].payload, ("127.0.0.1", source.address[1]))
            came += not next(packets).position
            time.sleep(0.02)
        assert "from 127.0.0.2 or others on the port of position packets" in caplog.text
        assert source.counts["strangers"] > 10


def test_a_flood_of_strangers_takes_none_of_the_sensors_room(caplog):
    """The kernel's buffer holds some thousand; all of the sensor's come, and every stranger is counted as one."""
    port = free_port()
    listener = PositionListener("127.0.0.1", port)
    me, sent = socket.inet_aton("127.0.0.1"), 60_000
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        stranger.bind(("127.0.0.2", 0))
        stranger.sendto(bytes(512), ("127.0.0.1", port))
        listener.among([], me)
        for number in range(sent):
            stranger.sendto(bytes(512), ("127.0.0.1", port))
            if number % 100 == 0:
                sensor.sendto(MIXED[0].payload, ("127.0.0.1", port))
        listener.among([], me)
        given = listener.among([], me)
    listener.close()
    assert len(given) == sent // 100
    assert listener.counts == {"strangers": sent + 1, "position packets": sent // 100}


@pytest.mark.parametrize(("own", "other"), [("::1", "::ffff:127.0.0.2"), ("::ffff:127.0.0.1", "::ffff:127.0.0.2")])
def test_the_filter_knows_both_kinds_of_addresses(own, other):
    listener = PositionListener("::", free_port())
    port = listener._socket.getsockname()[1]
    address = ip_address(own)
    sender = (address.ipv4_mapped or address).packed
    with (
        socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sensor,
        socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as stranger,
    ):
        sensor.bind((own, 0))
        stranger.bind((other, 0))
        for _ in range(3):
            sensor.sendto(MIXED[0].payload, ("::1" if own == "::1" else own, port))
            stranger.sendto(MIXED[0].payload, ("::ffff:127.0.0.1", port))
            listener.among([], sender)
        given = listener.among([], sender, anybody=True)  # from now on, and what waits
        stranger.sendto(MIXED[0].payload, ("::ffff:127.0.0.1", port))
        listener.among([], sender, anybody=True)
        given += listener.among([], sender, anybody=True)
    listener.close()
    assert (listener.counts["strangers"], listener.counts["position packets"]) == (3, 4)
    assert len(given) >= 1
