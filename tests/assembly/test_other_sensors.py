"""What a user would lose here: whole turns, packets at the edges of frames, and memory to a sensor gone mad."""

from __future__ import annotations

import random
from itertools import islice

import numpy as np
import pytest

from lidarcodec.assembly import Assembler, packets_of
from lidarcodec.assembly.assembler import MAX_FRAME_BYTES, TURN_NS
from lidarcodec.errors import PacketError
from lidarcodec.frame import Frame
from lidarcodec.packet import FirstPacket, Packet
from lidarcodec.packet_rest import MAX_ODD_BYTES
from lidarcodec.pipeline import frames_of
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.images import MAX_CELLS
from lidarcodec.sensors.models.table import any_packets, block_sensors, sensor_named
from lidarcodec.sources import open_source
from lidarcodec.units import MAX_COLUMNS, MAX_PACKETS
from tests.sensors.captures import CAPTURES
from tests.sensors.ouster_packets import FOLDER

STEP_NS = 1_327_000


def puck(azimuth: int = 0, number: int = 0) -> bytes:
    """A VLP-16 packet, two returns, whose blocks all look there."""
    block = b"\xff\xee" + azimuth.to_bytes(2, "little") + (1000 + number).to_bytes(2, "little") * 16 + bytes(64)
    return block * 12 + (number * 1327).to_bytes(4, "little") + b"\x39\x22"


def turning(turns: int, packets: int = 36) -> list[Packet]:
    """So many turns of a VLP-16."""
    return [
        Packet(puck(k % packets * 36_000 // packets, k % 1000), 10**18 + k * STEP_NS) for k in range(turns * packets)
    ]


def vlp16() -> SensorModel:
    return sensor_named("vlp16").generic_sensor


def widths(frames: list[Frame]) -> list[int]:
    return [frame.side.packets for frame in frames if frame.side is not None]


@pytest.mark.parametrize("framing", ["packets", "revolution"])
def test_a_frame_is_a_turn(framing: str) -> None:
    frames = list(frames_of(turning(4), vlp16(), framing))
    assert widths(frames) == [36] * 4
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    assert all(int(frame.azimuth[0, 0]) == 0 and frame.width == 36 * 12 for frame in frames)


def test_a_number_of_packets_is_a_frame_where_it_is_asked_for() -> None:
    assert widths(list(frames_of(turning(2), vlp16(), "packets:20"))) == [20, 20, 20, 12]


@pytest.mark.parametrize(
    ("capture", "turns"), [("vlp16", 4), ("vlp32c", 5), ("pandar64", 4), ("qt128", 2), ("xt16", 4)]
)
def test_a_capture_has_its_turns(data_file, capture: str, turns: int) -> None:
    with open_source(data_file(CAPTURES[capture])) as source:
        frames = list(frames_of(source.packets(), source.sensor))
    assert turns <= len(frames) <= turns + 2
    for frame in frames:
        steps = np.diff(frame.azimuth[0].astype(np.int64)) % 36_000
        assert steps[steps < 18_000].sum() <= 36_500


def test_a_window_of_a_turn_is_a_frame_by_its_number(data_file) -> None:
    with open_source(data_file(f"{FOLDER}/windowed_frame1.pcap.xz")) as source:
        frames = list(frames_of(source.packets(), source.sensor))
    assert 1 <= len(frames) <= 2


def test_packets_that_are_not_of_the_layout_end_no_turn() -> None:
    rng = random.Random(2)
    packets = turning(2)
    for k in range(5, 70, 7):
        packets[k] = packets[k]._replace(payload=rng.randbytes(rng.choice((10, 1206, 3000))))
    frames = list(frames_of(packets, vlp16()))
    assert widths(frames) == [36, 36]
    assert [packet for frame in frames for packet in packets_of(frame)] == packets


def test_odd_packets_are_counted() -> None:
    assembler = Assembler(vlp16())
    for packet in [*turning(1), Packet(b"odd", 10**18)]:
        assembler.push(packet)
    assert assembler.flush() is not None
    assert assembler.counts["odd packets"] == 1
    assert assembler.counts["packets"] == 37


def test_a_sensor_that_stands_still_gets_frames_too() -> None:
    packets = [Packet(puck(100, k % 1000), 10**18 + k) for k in range(MAX_PACKETS + 10)]
    frames = list(frames_of(packets, vlp16()))
    assert widths(frames) == [MAX_PACKETS, 10]
    assert [packet.payload for frame in frames for packet in packets_of(frame)] == [one.payload for one in packets]


@pytest.mark.parametrize("sensor", [sensor.name for sensor in block_sensors()])
def test_no_frame_has_more_bytes_columns_or_cells_than_the_limits(sensor: str) -> None:
    layout = max(sensor_named(sensor).layouts, key=lambda one: one.columns)  # type: ignore[attr-defined]
    assert layout.columns * min(MAX_PACKETS, MAX_FRAME_BYTES // layout.packet_bytes) <= 2 * MAX_COLUMNS
    assert layout.rows * layout.columns * len(layout.planes) <= MAX_CELLS


def test_large_packets_begin_a_frame_before_they_fill_memory() -> None:
    count = MAX_FRAME_BYTES // MAX_ODD_BYTES + 3
    packets = [Packet(bytes(MAX_ODD_BYTES), 10**18 + k) for k in range(count)]
    frames = list(frames_of(packets, any_packets()))
    assert widths(frames) == [MAX_FRAME_BYTES // MAX_ODD_BYTES, 3]
    with pytest.raises(PacketError, match="UDP ends at 65507"):
        Assembler(any_packets()).push(Packet(bytes(MAX_ODD_BYTES + 1), 0))


def test_packets_of_no_model_make_frames_of_a_tenth_of_a_second() -> None:
    packets = [Packet(bytes(10), 10**18 + k * TURN_NS // 5) for k in range(23)]
    assert widths(list(frames_of(packets, any_packets()))) == [5, 5, 5, 5, 3]


def test_position_packets_keep_their_places() -> None:
    packets = turning(3)
    for place in (0, 20, 37, 90, 111):
        packets.insert(place, Packet(bytes([place]) * 512, 10**18 + place * STEP_NS, position=True))
    frames = list(frames_of(packets, vlp16()))
    assert widths(frames) == [36, 36, 36]
    assert [packet for frame in frames for packet in packets_of(frame)] == packets


def test_another_sender_begins_a_frame() -> None:
    first, second = turning(1)[:10], turning(1)[:10]
    second[0] = FirstPacket(*second[0])
    assert widths(list(frames_of([*first, *second], vlp16()))) == [10, 10]


def test_two_modes_in_one_frame_come_back_though_one_of_them_has_no_image() -> None:
    packets = turning(1)
    for k in range(20, 36):
        packets[k] = packets[k]._replace(payload=packets[k].payload[:-2] + b"\x37\x22")
    (frame,) = frames_of(packets, vlp16())
    assert frame.width == 20 * 12
    assert list(packets_of(frame)) == packets
    assert len(list(islice(packets_of(frame), 36))) == 36
