"""What a user would lose here: the very packets of the sensor at the far end."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.assembly import Assembler, packets_of
from lidarcodec.errors import PacketError, SectionError
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.side import Role
from tests.packets import LOWER, UPPER, payload, read_plain_pcap, sensor, turning
from tests.sweeps import examples


def frames_of(packets: list[Packet], framing: str = "packets") -> tuple[list[Frame], Assembler]:
    assembler = Assembler(sensor(), framing)
    frames = [frame for packet in packets if (frame := assembler.push(packet))]
    last = assembler.flush()
    return frames + ([last] if last else []), assembler


def rebuilt(frames: list[Frame]) -> list[Packet]:
    return [packet for frame in frames for packet in packets_of(frame)]


@pytest.mark.parametrize("framing", ["packets", "packets:29", "packets:1", "revolution"])
def test_regular_packets_come_back(framing: str) -> None:
    packets = turning(400)
    frames, assembler = frames_of(packets, framing)
    assert rebuilt(frames) == packets
    assert [f.index for f in frames] == list(range(len(frames)))
    assert assembler.counts["packets"] == 400
    assert not set(assembler.counts) - {"packets", "frames"}


def test_348_packets_make_the_papers_image() -> None:
    packets = turning(348)
    frames, _ = frames_of(packets)
    (frame,) = frames
    assert frame.range.shape == (64, 2088)
    assert frame.fired.all()
    assert np.array_equal(frame.azimuth[0], frame.azimuth[1])
    first = np.frombuffer(packets[0].payload, np.dtype("<u2"), count=2, offset=0)
    assert first[0] == UPPER
    assert frame.range[5, 0] == int.from_bytes(packets[0].payload[4 + 15 : 4 + 17], "little")
    assert frame.intensity[40, 0] == packets[0].payload[100 + 4 + 8 * 3 + 2]


def test_revolutions_are_cut_behind_the_wrap() -> None:
    frames, _ = frames_of(turning(1000, start=35000), "revolution")
    assert {f.width for f in frames[1:-1]} <= {1998, 2004}
    assert all(int(f.azimuth[0, 0]) < 108 for f in frames[1:])


def test_sensor_that_stands_still_does_not_fill_memory() -> None:
    rng = np.random.default_rng(0)
    packets = [Packet(payload([(UPPER, 100), (LOWER, 100)] * 6, rng), 0)] * 5000
    frames, assembler = frames_of(packets, "revolution")
    assert rebuilt(frames) == packets
    assert max(f.side.packets for f in frames if f.side) == 2048
    assert assembler.counts["repeated packets"] == 4999


def test_three_upper_blocks_for_one_lower() -> None:
    """The order of the real HDL-64E S3 capture."""
    rng = np.random.default_rng(0)
    blocks = [(LOWER if b % 4 == 0 else UPPER, 1000 + 9 * b) for b in range(12)]
    packets = [Packet(payload(blocks, rng), 0)]
    (frame,), _ = frames_of(packets)
    assert frame.width == 9
    assert frame.fired[0].all()
    assert frame.fired[1].tolist() == [True, False, False] * 3
    assert frame.azimuth[:, 0].tolist() == [1009, 1000]
    assert frame.azimuth[:, 1].tolist() == [1018, 1018]
    assert not frame.range[32:, 1].any()
    assert rebuilt([frame]) == packets


@pytest.mark.parametrize("order", [(UPPER, LOWER, UPPER, LOWER), (UPPER, UPPER, LOWER, LOWER)])
def test_second_returns_are_kept_apart(order: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    blocks = [(flag, 1000 + 18 * firing) for firing in range(3) for flag in order]
    packets = [Packet(payload(blocks, rng), 0)]
    (frame,), _ = frames_of(packets)
    assert frame.width == 3
    assert frame.fired.all()
    assert frame.side is not None
    assert len(frame.side.second) == 6
    assert set(frame.side.layouts[0].tolist()) <= set(Role)
    assert rebuilt([frame]) == packets


def test_lost_and_jumping_time_is_counted() -> None:
    packets = turning(1000)
    del packets[100:103]
    late = packets[600]
    packets[600] = Packet(late.payload[:1200] + (12).to_bytes(4, "little") + late.payload[1204:], late.stamp_ns)
    frames, assembler = frames_of(packets)
    assert rebuilt(frames) == packets
    assert assembler.counts["lost packets"] == 3
    assert assembler.counts["time jumps"] >= 1


def test_the_hour_wrap_is_no_jump() -> None:
    packets = [
        Packet(
            p.payload[:1200] + ((3_599_950_000 + 288 * i) % 3_600_000_000).to_bytes(4, "little") + p.payload[1204:], 0
        )
        for i, p in enumerate(turning(700))
    ]
    _, assembler = frames_of(packets)
    assert not set(assembler.counts) - {"packets", "frames"}


blocks = st.tuples(
    st.sampled_from([UPPER, LOWER, UPPER, LOWER, 0, 0xFFFF, 0xEEFE]),
    st.sampled_from([0, 9, 18, 59, 35990, 36000, 65535]),
)


@given(st.lists(st.lists(blocks, min_size=12, max_size=12), max_size=6), st.sampled_from(["packets:2", "revolution"]))
@settings(max_examples=examples(200), deadline=None)
def test_any_order_of_blocks_comes_back(orders: list[list[tuple[int, int]]], framing: str) -> None:
    rng = np.random.default_rng(1)
    packets = [Packet(payload(order, rng, gps_us=i * 7919), i) for i, order in enumerate(orders)]
    frames, _ = frames_of(packets, framing)
    assert rebuilt(frames) == packets


@given(st.lists(st.binary(min_size=1206, max_size=1206), max_size=3))
@settings(max_examples=examples(100), deadline=None)
def test_any_bytes_come_back(payloads: list[bytes]) -> None:
    packets = [Packet(p, i) for i, p in enumerate(payloads)]
    assert rebuilt(frames_of(packets)[0]) == packets


@pytest.mark.parametrize("size", [0, 1, 512, 1205, 1207, 65507])
def test_other_lengths_are_refused_and_harm_nothing(size: int) -> None:
    assembler = Assembler(sensor(), "packets:2")
    packets = turning(2)
    assert assembler.push(packets[0]) is None
    with pytest.raises(PacketError, match=str(size)):
        assembler.push(Packet(bytes(size), 0))
    frame = assembler.push(packets[1])
    assert frame is not None
    assert packets_of(frame) == packets


def test_parts_that_do_not_fit_are_refused() -> None:
    (frame,), _ = frames_of(turning(3))
    side = frame.side
    assert side is not None
    narrower = Frame(
        0,
        0,
        frame.range[:, :-1],
        frame.intensity[:, :-1],
        frame.azimuth[:, :-1],
        frame.fired[:, :-1],
        frame.sensor,
        side,
    )
    unfired = frame.with_(fired=np.zeros_like(frame.fired))
    for wrong in (narrower, unfired, frame.with_(side=None)):
        with pytest.raises(SectionError):
            packets_of(wrong)


@pytest.mark.parametrize("framing", ["packets", "revolution"])
def test_the_real_capture_comes_back(data_file, framing: str) -> None:
    packets = read_plain_pcap(data_file("hdl64e_s3_atwall.pcap"))
    assert len(packets) == 306
    frames, assembler = frames_of(packets, framing)
    assert rebuilt(frames) == packets
    assert frames[0].fired[0].all()
    assert abs(float(frames[0].fired[1].mean()) - 1 / 3) < 0.01
    assert "irregular blocks" not in assembler.counts
