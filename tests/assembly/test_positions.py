"""Position packets through frames and back: none may vanish, and none may change its place among data packets."""

from __future__ import annotations

import random

import pytest

from lidarcodec.assembly import Assembler, packets_of
from lidarcodec.packet import Packet, data_packets, part_of
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.units import MAX_POSITIONS
from tests.packets import sensor, turning
from tests.positions import interleaved, position

LAST = turning(401)[-1].stamp_ns


def mixed(seed: int = 1, count: int = 400) -> list[Packet]:
    """Data packets of four turns with position packets before, between and behind them, some in a row."""
    rng, found = random.Random(seed), []
    for packet in turning(count, seed):
        found += [position(packet.stamp_ns - 3000 + 1000 * k) for k in range(rng.choice((0, 0, 0, 0, 1, 3)))]
        found.append(packet)
    return [position(found[0].stamp_ns - 10**9), *found, position(LAST), position(LAST + 10**9)]


@pytest.mark.parametrize("framing", ["packets", "packets:29", "packets:100", "packets:400", "packets:1", "revolution"])
def test_all_come_back_in_order(framing):
    sent = mixed()
    frames = list(frames_of(sent, sensor(), framing))
    assert [packet for frame in frames for packet in packets_of(frame)] == sent
    assert sum(len(frame.side.positions) for frame in frames if frame.side) == sum(p.position for p in sent)
    assert [frame.index for frame in frames] == list(range(len(frames)))


@pytest.mark.parametrize("codec", ["pcodec", "raw", "predictive", "jpeg-layered", "h264"])
def test_they_pass_through_codecs_and_reductions(codec):
    bound = {"max_error_m": 0.0} if codec in ("pcodec", "raw", "predictive") else {}
    encoder, decoder = StreamEncoder(StreamSettings(codec=codec, reduction="columns:2", **bound)), StreamDecoder()
    came = []
    for frame in frames_of(mixed(count=120), sensor(), "packets:50"):
        came += [decoded for message in encoder.encode(frame) for decoded in decoder.decode(message)]
    came += [decoded for message in encoder.flush() for decoded in decoder.decode(message)] + decoder.flush()
    back = [packet for frame in came for packet in packets_of(frame)]
    sent = mixed(count=120)
    assert [p.position for p in back] == [p.position for p in sent]
    assert [p for p in back if p.position] == [p for p in sent if p.position]


def test_without_them_nothing_of_a_message_changes():
    sent = mixed(count=60)
    alone = list(frames_of(data_packets(sent), sensor(), "packets:30"))
    encoder = StreamEncoder(StreamSettings(), stream_id=1)
    assert all(section.type != 13 for frame in alone for one in encoder.encode(frame) for section in one.sections)


def test_live_those_behind_the_last_frame_are_counted():
    assembler = Assembler(sensor(), "packets:20")
    frames = [frame for packet in mixed(count=20) if (frame := assembler.push(packet))]
    assert len(frames) == 1
    assert assembler.flush() is None
    assert assembler.counts["position packets not kept"] == 2
    assert assembler.flush() is None
    assert assembler.counts["position packets not kept"] == 2


def test_a_flood_of_them_is_bounded_and_counted():
    flood = [position(LAST)] * (MAX_POSITIONS + 7)
    assembler = Assembler(sensor(), "packets")
    for packet in [*flood, Packet(bytes(1473), 0, position=True), *turning(1)]:
        assembler.push(packet)
    frame = assembler.flush()
    assert frame is not None
    assert len(frame.side.positions) == MAX_POSITIONS
    assert assembler.counts["position packets not kept"] == 8
    (last,) = frames_of([*turning(1), *flood], sensor(), "packets:1")
    assert len(last.side.positions) == MAX_POSITIONS


def test_a_part_has_the_position_packets_within_it():
    sent = list(interleaved(turning(100), every=10, first=0))
    sent.append(position(LAST))
    assert list(part_of(sent, 0, None)) == sent
    part = list(part_of(sent, 10, 20))
    assert list(data_packets(part)) == turning(100)[10:30]
    assert sum(p.position for p in part) == 2  # before packet 20, and before packet 30
    assert list(part_of(sent, 200, 5)) == []
    assert list(part_of(sent, 0, 0)) == sent[:1]
