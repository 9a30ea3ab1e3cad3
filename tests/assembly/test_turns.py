"""What somebody loses if these fail: a view of the whole surroundings in each frame, or a packet at one of its ends."""

from __future__ import annotations

from itertools import islice

import pytest

from lidarcodec.assembly import Assembler, packets_of
from lidarcodec.assembly.rotation import RotationWatch, turns_of
from lidarcodec.packet import LastPacket, Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source


def payload(*rotations: int) -> bytes:
    """Six firings with these rotations, in twelve blocks."""
    blocks = (
        (b"\xff\xee", b"\xff\xdd")[half] + at.to_bytes(2, "little") + bytes(96) for at in rotations for half in (0, 1)
    )
    return b"".join(blocks) + bytes(6)


def test_a_turn_is_the_default():
    assert StreamSettings().framing == "revolution"
    with open_source("sim:city?frames=3") as source:
        frames = list(frames_of(source.packets(), source.sensor))
    assert [frame.width for frame in frames] == pytest.approx([2154] * 3, abs=6)


@pytest.mark.parametrize("name", ["kitti_0005.pcap.xz", "kitti_sfnd_f000-049.pcap.xz", "kitti_0013_f052-107.pcap.xz"])
def test_the_first_frame_of_a_drive_is_a_whole_turn(data_file, name):
    """KITTI's captures are cut at the wrap: in two of them the first packet begins half a degree before it, and was a
    frame of 101 points."""
    with open_source(data_file(name)) as source:
        frames = list(islice(frames_of(source.packets(), source.sensor), 2))
    assert all(2148 <= frame.width <= 2166 for frame in frames)


def test_a_capture_that_begins_and_ends_within_a_turn_has_short_frames_and_loses_nothing():
    with open_source("sim:city?seed=1&packets=500") as source:
        packets = list(source.packets())
        frames = list(frames_of(packets, source.sensor))
    assert [frame.side.packets for frame in frames] == [55, 359, 86]
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert [packet for frame in frames for packet in packets_of(frame)] == packets


def test_only_the_first_packet_may_open_a_turn_with_the_end_of_another():
    watch, crossing = RotationWatch(), payload(35960, 35978, 35996, 14, 32, 50)
    assert [watch.begins(one) for one in (crossing, payload(68, 86, 104, 122, 140, 158), crossing)] == [False] * 3
    assert watch.begins(payload(68, 86, 104, 122, 140, 158))


def test_a_last_packet_ends_a_turn_without_the_next_one_but_no_slab():
    with open_source("sim:city?frames=1") as source:
        *packets, last = source.packets()
        packets.append(LastPacket(*last))
        for framing, sizes in (("revolution", [len(packets)]), ("packets:200", [200, len(packets) - 200])):
            assembler = Assembler(source.sensor, framing)
            found = [assembler.push(packet) for packet in packets]
            assert (found[-1] is not None) == (framing == "revolution")
            frames = [frame for frame in (*found, assembler.flush()) if frame is not None]
            assert [frame.side.packets for frame in frames] == sizes


def test_turns_are_counted_by_the_rotation():
    with open_source("sim:city?packets=1000") as source:
        packets = list(turns_of([Packet(b"", 0, position=True), *source.packets()], 2))
    assert len(packets) == 1 + 55 + 359
