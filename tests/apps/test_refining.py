"""Refinements of a live stream: exact where they came, given up where the next frame came first, never passed off."""

from __future__ import annotations

import time

import numpy as np
import pytest

from lidarcodec.apps.once import Once
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.publisher.pacing import ALONE_EVERY
from lidarcodec.apps.publisher.refining import Refining
from lidarcodec.apps.receiver.refinements import Refinements
from lidarcodec.apps.reports import Refined, pack_refined
from lidarcodec.assembly import packets_of
from lidarcodec.errors import TransportError
from lidarcodec.evaluation.recorded import RecordedFrames
from lidarcodec.layers import pack, unpack
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import checksum_of
from tests.apps.in_memory import live, publisher
from tests.apps.streams import Loop
from tests.layers.bases import Sent, sent, turn
from tests.transport.test_contract import eventually

KEYS = StreamKeys()
LAYERS = StreamSettings(codec="pcodec", base_error_m=0.05, framing="packets")


def logger_of(caplog=None):
    """Counts errors."""
    import logging

    return Once(logging.getLogger("test"))


def test_packets_are_exact_when_all_sectors_came_and_are_recorded_so(network, tmp_path):
    for rate in (1.0, 0.3, 0.1):  # a busy machine needs more time for all sectors of a frame
        record = tmp_path / str(rate)
        with live(network, newest=False, until_end=True, refine=True, record=record, max_age_s=None) as stream:
            with publisher(network, 3, LAYERS, rate=rate) as car:
                got = [packet.payload for frame in stream for packet in packets_of(frame)]
                told = car.status()["refinements"]
            summary = stream.summary()
        if told["whole"] == 3:
            break
    assert got == Loop(3).payloads()
    assert summary["refinements"] == {"taken": 36, "whole": 3, "lost": 0}
    assert summary["errors"] == {}
    assert {name: told[name] for name in ("frames", "whole", "sent", "arrived", "given_up")} == {
        "frames": 3, "whole": 3, "sent": 36, "arrived": 36, "given_up": 0,
    }  # fmt: skip
    (path,) = record.glob("*.mcap")
    recorded = RecordedFrames(path)
    assert [packet.payload for frame in recorded for packet in packets_of(frame)] == got


def test_who_does_not_ask_gets_the_base_and_nothing_is_coded_for_nobody(network):
    with live(network, newest=False, until_end=True) as stream:
        with publisher(network, 3, LAYERS, rate=3.0) as car:
            got = [packet.payload for frame in stream for packet in packets_of(frame)]
            told = car.status()["refinements"]
        assert stream.summary()["refinements"] is None
    assert len(got) == 3 * 348
    assert got != Loop(3).payloads()
    assert 1 <= told["no_receiver"] <= 3  # a frame may be replaced before anybody looks
    assert told["sent"] == 0


def test_an_error_of_the_transport_ends_one_frame_only(network):
    class Failing:
        """Fails at its first sector."""

        def __init__(self):
            self.end, self.failed = network.end(), False

        def listen(self, key, handler):
            return self.end.listen(key, handler)

        def sender(self, key, priority):
            sender, put = self.end.sender(key, priority), None
            put = sender.put

            def failing(data):
                if not self.failed:
                    self.failed = True
                    raise TransportError("the session is closed")
                put(data)

            sender.put = failing
            return sender

    other, once = network.end(), logger_of()
    came: list[bytes] = []
    other.listen(KEYS.refine(), lambda key, data: came.append(data))
    car = Failing()
    refining = Refining(KEYS, lambda: car, Flight(), once)
    for index in range(2):
        refining.offer(sent(turn(index=index)).refinable, 1)
        assert eventually(lambda index=index: (once.counts["refinement errors"], len(came)) == (1, index))
        refining.next_frame()
    assert once.counts["refinement errors"] == 1
    refining.close()


def test_the_rest_is_given_up_when_the_next_frame_comes(network):
    car, other = network.end(), network.end()
    flight = Flight()
    refining = Refining(KEYS, lambda: car, flight, logger_of())
    came: list[bytes] = []
    other.listen(KEYS.refine(), lambda key, data: came.append(data))
    reports = other.sender(KEYS.refined("desk"), Priority.REAL_TIME)
    first, second = sent(), sent(turn(index=1))
    begun_s = time.monotonic()
    refining.offer(first.refinable, 1)
    assert eventually(lambda: len(came) == 1)
    time.sleep(0.1)
    assert len(came) == 1  # one is under way
    wrong = Refined(0, 1, unpack(came[0]).sector)
    reports.put(pack_refined(wrong))
    reports.put(b"short")
    reports.put(pack_refined(Refined(0, checksum_of(came[0]), unpack(came[0]).sector)))
    assert eventually(lambda: len(came) == 2)
    refining.next_frame()
    assert eventually(lambda: refining.state()["given_up"] == 10)
    assert [unpack(data).sector for data in came] == [0, 11]
    reports.put(pack_refined(Refined(0, checksum_of(came[1]), unpack(came[1]).sector)))
    time.sleep(4.0 * (time.monotonic() - begun_s))  # as long as some sectors took: there is room for one
    refining.offer(second.refinable, 1)
    assert eventually(lambda: len(came) == 3)
    assert refining.state()["arrived"] == 2
    refining.close()
    refining.close()


@pytest.mark.parametrize("tight", [0, ALONE_EVERY - 1], ids=["nothing fits", "nothing beside its message"])
def test_the_last_frame_is_refined_also_if_nothing_was_sent_for_it_at_first(network, tight):
    car, other, came = network.end(), network.end(), []
    refining = Refining(KEYS, lambda: car, Flight(), logger_of())
    reports = other.sender(KEYS.refined("desk"), Priority.REAL_TIME)

    def report(key, data):
        came.append(unpack(data).frame_index)
        reports.put(pack_refined(Refined(came[-1], checksum_of(data), unpack(data).sector)))

    other.listen(KEYS.refine(), report)
    refining.offer(sent().refinable, 1)
    assert eventually(lambda: refining.state()["arrived"] == 12)
    refining.next_frame()
    refining._pacing._s_per_byte, refining._pacing._tight = 1.0, tight  # a slow link
    refining.offer(sent(turn(index=1)).refinable, 1)
    assert eventually(lambda: refining.state()["frames"] == 2)
    time.sleep(0.1)
    assert came == [0] * 12
    refining.finish(30.0)
    assert came[12:] == [1] * 12
    told = refining.state()
    assert (told["whole"], told["given_up"], told["arrived"]) == (2, 0, 24)
    refining.close()


def test_what_one_receiver_showed_is_not_used_for_the_next(network):
    flight, car = Flight(), network.end()
    refining = Refining(KEYS, lambda: car, flight, logger_of())
    flight.came("near")
    refining.offer(sent().refinable, 1)
    refining._pacing.sector_took(9.0, 0.0, 1000, 0.0)
    refining.offer(sent(turn(index=1)).refinable, 1)
    assert refining._pacing.s_per_byte > 0.0
    flight.went("near")
    refining.offer(sent(turn(index=2)).refinable, 1)
    flight.came("near")  # it is back
    refining.offer(sent(turn(index=3)).refinable, 1)
    assert refining._pacing.s_per_byte > 0.0
    flight.went("near")
    flight.came("far")
    refining.offer(sent(turn(index=4)).refinable, 1)
    assert refining._pacing.s_per_byte == 0.0
    refining.close()


def receiving(network) -> tuple[Refinements, list, object]:
    frames: list = []
    refinements = Refinements(KEYS, "desk", frames.append, lambda data: None, logger_of())
    declared = refinements.declare(network.end())
    return refinements, frames, declared


def put(network, given: Sent, sectors) -> None:
    end = network.end()
    for sector in sectors:
        end.sender(KEYS.refine(sector), Priority.BESIDE).put(given.refinable.code(sector))


def test_a_receiver_takes_sectors_before_their_base_and_counts_late_damaged_and_foreign_ones(network):
    refinements, frames, declared = receiving(network)
    given, end = sent(), network.end()
    put(network, given, [0, 3])
    time.sleep(0.2)
    refinements.message(given.message)
    refinements.base(given.base, given.message)
    assert eventually(lambda: refinements.counts["taken"] == 2)
    damaged = bytearray(given.refinable.code(1))
    damaged[60] ^= 1
    end.sender(KEYS.refine(1), Priority.BESIDE).put(bytes(damaged))
    foreign = pack(unpack(given.refinable.code(1))._replace(base=5))
    end.sender(KEYS.refine(1), Priority.BESIDE).put(foreign)
    end.sender(KEYS.refine(1), Priority.BESIDE).put(b"")
    assert eventually(lambda: refinements._once.counts["refinement_errors"] == 3)
    refinements.flush()
    (frame,) = frames
    columns = np.isin(frame.azimuth[0] // 3000, (0, 3))
    np.testing.assert_array_equal(frame.range[:, columns], given.frame.range[:, columns])
    np.testing.assert_array_equal(frame.range[:, ~columns], given.base.range[:, ~columns])
    put(network, given, [5])
    assert eventually(lambda: refinements.counts["late"] == 1)
    assert refinements.counts["part"] == 1
    refinements.close()
    for one in declared:
        one.close()


def test_a_frame_is_given_at_once_when_its_last_sector_came(network):
    refinements, frames, declared = receiving(network)
    given = sent()
    refinements.message(given.message)
    refinements.base(given.base, given.message)
    assert not frames
    put(network, given, reversed(range(12)))
    assert eventually(lambda: len(frames) == 1)
    np.testing.assert_array_equal(frames[0].range, given.frame.range)
    refinements.flush()
    assert len(frames) == 1
    assert refinements.counts["whole"] == 1
    refinements.close()
    for one in declared:
        one.close()


def test_refinements_of_others_hold_up_no_frame_and_fill_no_recording(network):
    """They were decoded and recorded without end: no frame in 12 s, 48 MB instead of 7."""
    frames, kept = [], []
    refinements = Refinements(KEYS, "desk", frames.append, kept.append, logger_of())
    declared = refinements.declare(network.end())
    given, end = sent(), network.end()
    sectors = [end.sender(KEYS.refine(sector), Priority.BESIDE) for sector in range(12)]

    def came():
        return sum(refinements.counts[name] for name in ("taken", "late", "lost", "left_out")) + errors()

    def errors():
        return refinements._once.counts["refinement_errors"]

    refinements.message(given.message)
    refinements.base(given.base, given.message)
    for number in range(100):
        forged = unpack(given.refinable.code(number % 12))._replace(ranges=bytes([number]) * 40)
        sectors[number % 12].put(pack(forged))
        assert eventually(lambda: came() > number)  # noqa: B023
    assert errors() == 12, "as many as a frame has sectors"
    assert len(kept) == 48, "four of each sector"
    assert refinements.counts["left_out"] == 52
    huge = unpack(given.refinable.code(11))._replace(ranges=bytes(200_000))
    refinements._admission.message(sent(turn(index=5)).message)
    sectors[11].put(pack(huge._replace(frame_index=5)))
    assert eventually(lambda: refinements.counts["left_out"] == 53), "more than all that the frame has"
    refinements.flush()
    assert len(frames) == 1
    for number in range(100):  # of frames that never come
        forged = unpack(given.refinable.code(0))._replace(frame_index=1000 + number)
        sectors[0].put(pack(forged))
    following = sent(turn(index=1))
    put(network, following, [0, 1])
    refinements.message(following.message)
    refinements.base(following.base, following.message)
    assert eventually(lambda: refinements.counts["taken"] == 2)
    assert len(kept) == 50
    refinements.close()
    for one in declared:
        one.close()
