"""Turns cut into parts: no packet is lost or moved, and the parts make the turn again."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec.assembly import Assembler, packets_of
from lidarcodec.assembly.rotation import PartWatch, part_ends
from lidarcodec.assembly.turns import TurnJoiner, joined
from lidarcodec.errors import LidarCodecError
from lidarcodec.frame import WHOLE, Frame, Part
from lidarcodec.packet import FirstPacket, Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.side import SideInfo
from tests.apps.streams import Loop
from tests.contracts import frames


def packets(turns: int) -> list[Packet]:
    """Packets of whole turns."""
    return list(Loop(turns).packets())


def cut(given: list[Packet], framing: str) -> list[Frame]:
    """Frames of packets."""
    return list(frames_of(given, Loop(1).sensor, framing))


@pytest.mark.parametrize("parts", [2, 3, 5, 8])
def test_parts_hold_all_packets_and_make_the_turns(parts: int) -> None:
    given = packets(2)
    came = cut(given, f"parts:{parts}")
    assert [frame.part for frame in came] == 2 * [Part(part > 0, part < parts - 1) for part in range(parts)]
    widths = [frame.width for frame in came]
    assert widths[:parts] == sorted(widths[:parts], reverse=True)
    assert [packet.payload for frame in came for packet in packets_of(frame)] == [packet.payload for packet in given]
    joiner = TurnJoiner()
    turns = [turn for frame in came for turn in joiner.add(frame)]
    for turn, whole in zip(turns, cut(given, "revolution"), strict=True):
        assert turn.part == WHOLE
        assert turn.stamp_ns == whole.stamp_ns
        for name in ("range", "intensity", "azimuth", "fired"):
            np.testing.assert_array_equal(getattr(turn, name), getattr(whole, name))
        assert [one.stamp_ns for one in packets_of(turn)] == [one.stamp_ns for one in packets_of(whole)]
        assert [one.payload for one in packets_of(turn)] == [one.payload for one in packets_of(whole)]


def test_a_capture_may_begin_and_end_within_a_turn() -> None:
    came = cut(packets(1)[200:340], "parts:4")
    assert sum(len(packets_of(frame)) for frame in came) == 140
    assert [frame.part.goes_on for frame in came] == [False, True, True]
    assert came[-1].part == Part(True, False)


def test_a_new_sender_begins_a_turn() -> None:
    given = packets(1)
    again = [FirstPacket(given[0].payload, given[0].stamp_ns), *given[1:]]
    came = cut(given[:200] + again, "parts:3")
    begins = [frame.index for frame in came if not frame.part.goes_on]
    assert begins == [0, 2]
    assert came[1].part == Part(True, False)


def test_position_packets_and_times_keep_their_places_in_the_turn() -> None:
    given = packets(1)
    for at in (300, 170, 1):
        given.insert(at, Packet(b"GPS%d" % at, given[at].stamp_ns - 1000, position=True))
    joiner = TurnJoiner()
    (turn,) = [turn for frame in cut(given, "parts:3") for turn in joiner.add(frame)]
    assert [(one.payload, one.stamp_ns) for one in packets_of(turn)] == [(one.payload, one.stamp_ns) for one in given]


def test_what_came_of_a_turn_is_given_when_the_next_begins() -> None:
    came, joiner = cut(packets(3), "parts:3"), TurnJoiner()
    given = [[turn.index for turn in joiner.add(frame)] for frame in came if frame.index not in (1, 8)]
    assert given == [[], [0, 2], [], [], [3], [], []]  # 2 has lost 1 and is a piece of its own
    assert [turn.index for turn in joiner.flush()] == [6]
    assert joiner.flush() == []


def parts_of(*given: Frame) -> list[Frame]:
    """Frames as consecutive parts of a turn that does not end."""
    return [frame.with_(index=index, part=Part(index > 0, True)) for index, frame in enumerate(given)]


@pytest.mark.parametrize(
    ("second", "sizes"),
    [
        ({"lattice": np.array([0, 5], np.uint16)}, [6, 6]),
        ({"keep": np.ones((64, 6), np.bool_)}, [6, 6]),
        ({"sensor": frames.sensor(5)}, [6, 6]),
        ({"stamp_ns": 2**63 - 1}, [6, 6]),
        ({"stamp_ns": -(2**63)}, [6, 6]),
        ({"side": SideInfo.regular(packets=2048)}, [6, 6]),
    ],
)
def test_a_part_that_fits_no_turn_ends_no_stream(second: dict[str, object], sizes: list[int]) -> None:
    """A stranger on an open network, or a vehicle, would end every receiver of the stream with one message."""
    one = frames.scene(1)
    joiner, came = TurnJoiner(), []
    for frame in parts_of(one, one.with_(**second)):
        came += joiner.add(frame)
    came += joiner.flush()
    assert [frame.width for frame in came] == sizes
    assert all(frame.part == WHOLE for frame in came)
    (turn,) = [turn for frame in cut(packets(1), "parts:3") for turn in joiner.add(frame)]
    assert turn.width == cut(packets(1), "revolution")[0].width


def test_parts_without_end_take_no_more_room_than_a_turn() -> None:
    joiner, came = TurnJoiner(), []
    for frame in parts_of(*[frames.scene(1)] * 50):
        came += joiner.add(frame)
    assert [frame.width for frame in came] == [8 * 6] * 6
    wide, joiner, came = frames.noise(2048).with_(side=None), TurnJoiner(), []
    for frame in parts_of(*[wide] * 4):
        came += joiner.add(frame)
    assert [frame.width for frame in came] == [24576]


def test_frames_of_different_sensors_are_no_turn() -> None:
    one = frames.scene(2)
    with pytest.raises(LidarCodecError, match="cannot be joined into one turn"):
        joined([one, frames.scene(2, sensor=frames.sensor(5))])
    assert joined([one]) is one


def test_damaged_rotations_begin_no_part() -> None:
    watch = PartWatch(3)
    payload = lambda rotation: rotation.to_bytes(2, "little").rjust(4) + bytes(1202)  # noqa: E731
    assert part_ends(3) == [18000, 30000, 36000]
    seen = [(0, True), (17999, False), (65535, False), (18000, False), (9000, False), (35000, False), (40000, False)]
    begins = [watch.begins(payload(rotation), turn=turn) for rotation, turn in seen]
    assert begins == [False, False, False, True, False, True, False]


def test_other_framings_are_as_they_were() -> None:
    assembler = Assembler(Loop(1).sensor, "packets:29")
    assert all(frame is None or frame.part == WHOLE for frame in map(assembler.push, packets(1)))
