"""`verify` is what a user trusts a recording by: it must find the right packets again and miss no wrong one."""

import numpy as np
import pytest

from lidarcodec.codecs import table
from lidarcodec.errors import SourceError
from lidarcodec.evaluation.verdict import broken_promises, changed_since_the_start
from lidarcodec.evaluation.verify import Comparison, PacketsByTime, Promise, promise_of
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import StreamSettings
from tests.packets import UPPER, payload, sensor, turning


def frames(packets, size=10):
    return list(frames_of(packets, sensor(), f"packets:{size}"))


def compared(decoded, source):
    comparison, packets = Comparison(), PacketsByTime(source)
    for frame in decoded:
        comparison.add(frame, packets)
    return comparison, packets


def test_the_same_packets_are_identical():
    found, packets = compared(frames(turning(60)), turning(60))
    assert found.packets_identical
    assert (found.packets, packets.passed, found.errors.max_error_m) == (60, 0, 0)
    assert broken_promises(StreamSettings(), found) == []


def test_frames_that_are_missing_in_the_recording_are_passed_over():
    decoded = frames(turning(60))
    found, packets = compared([decoded[1], decoded[4]], turning(60))
    assert found.packets_identical
    assert (found.frames, packets.passed) == (2, 30)


def test_one_byte_that_differs_is_found():
    source = turning(60)
    wrong = bytearray(source[33].payload)
    wrong[700] ^= 1
    source[33] = Packet(bytes(wrong), source[33].stamp_ns)
    found, _ = compared(frames(turning(60)), source)
    assert not found.packets_identical
    assert found.identical_packets == 59
    assert broken_promises(StreamSettings(), found)


def test_a_packet_that_the_source_lacks_is_not_made_up():
    source = turning(60)
    del source[20:30]
    found, _ = compared(frames(turning(60)), source)
    assert found.not_in_source == 1
    assert "1 frames are not in the source" in broken_promises(StreamSettings(), found)


def test_packets_of_one_time_are_told_apart_by_their_bytes():
    source = [Packet(packet.payload, packet.stamp_ns // 10**8 * 10**8) for packet in turning(60)]
    decoded = frames(source)
    found, packets = compared([decoded[2], decoded[5]], source)
    assert found.packets_identical
    assert packets.passed == 40


def test_another_drive_of_the_same_time_is_refused():
    rng = np.random.default_rng(2)
    upper_only = [(UPPER, 18 * block) for block in range(12)]
    other = [Packet(payload(upper_only, rng), packet.stamp_ns) for packet in turning(60)]
    with pytest.raises(SourceError, match="not made from this source"):
        compared(frames(turning(60)), other)


@pytest.mark.parametrize(("steps", "kept"), [(5, True), (6, False)])
def test_a_bound_is_held_to_the_step(steps, kept):
    decoded = [
        frame.with_(range=np.where(frame.range > 100, frame.range - np.uint16(steps), frame.range))
        for frame in frames(turning(20))
    ]
    found, _ = compared(decoded, turning(20))
    assert found.errors.max_error_m == pytest.approx(steps * 0.002)
    assert (broken_promises(StreamSettings(max_error_m=0.01), found) == []) is kept


def test_a_return_that_is_lost_or_invented_breaks_every_promise():
    frame = frames(turning(10))[0]
    changed = frame.range.copy()
    changed[3, 4], changed[10, 5] = 0, 4000
    found, _ = compared([frame.with_(range=np.where(frame.range[3, 4] > 0, changed, frame.range))], turning(10))
    assert found.errors.lost + found.errors.invented > 0
    assert any("lost" in text for text in broken_promises(StreamSettings(max_error_m=20.0), found))


@pytest.mark.parametrize("promise", [Promise(None, False), Promise(None, False, reduced=True)])
def test_the_recording_of_another_drive_breaks_promises_without_a_bound_too(promise):
    """Of `jpeg` and `h264` it said `kept all that its messages promise`, with code 0, whatever drive it was of."""
    frame, found = frames(turning(10))[0], Comparison()
    found.add(frame.with_(range=np.roll(frame.range, 7, axis=0)), PacketsByTime(turning(10)), promise)
    assert found.errors.invented > 0
    assert any("were added" in text for text in broken_promises(StreamSettings(codec="jpeg"), found))


def coded(settings, packets):
    """What decodes of a stream of frames, with what each message promises."""
    encoder, decoder = StreamEncoder(settings), StreamDecoder()
    messages = [message for frame in frames(packets) for message in encoder.encode(frame)] + encoder.flush()
    return [(frame, promise_of(message)) for message in messages for frame in decoder.decode(message)]


@pytest.mark.parametrize(
    ("codec", "bound_m"),
    [(name, bound) for name in table.names() for bound in (None, 0.05) if bound is None or table.codec(name).bounded],
)
def test_every_message_says_what_it_promises_and_keeps_it(codec, bound_m):
    bounded = table.codec(codec).bounded
    settings = StreamSettings(codec=codec, max_error_m=bound_m)
    found, packets = Comparison(), PacketsByTime(turning(60))
    for frame, promise in coded(settings, turning(60)):
        assert promise.step == ((1 if codec == "raw" else settings.step) if bounded else None)
        assert promise.identical is (bounded and codec != "raw" and bound_m is None)
        found.add(frame, packets, promise)
    assert found.frames == 6
    assert broken_promises(settings, found) == []
    assert changed_since_the_start(settings, found) == []


@pytest.mark.parametrize("codec", ["zstd", "riddle"])
@pytest.mark.parametrize("intensity", ["levels=2", "error=9"])
def test_few_intensities_promise_no_packets(codec, intensity):
    found, packets = Comparison(), PacketsByTime(turning(60))
    for frame, promise in coded(StreamSettings(codec=codec, intensity=intensity), turning(60)):
        assert (promise.step, promise.identical) == (1, False)
        found.add(frame, packets, promise)
    assert not found.packets_identical
    assert found.differing == 0


def test_a_bound_that_was_loosened_on_the_way_is_told_and_breaks_nothing():
    found, packets = Comparison(), PacketsByTime(turning(60))
    fine = coded(StreamSettings(max_error_m=0.01), turning(60))
    coarse = coded(StreamSettings(max_error_m=0.2), turning(60))
    for frame, promise in fine[:4] + coarse[4:]:
        found.add(frame, packets, promise)
    assert 0.01 < found.errors.max_error_m <= 0.2
    settings = StreamSettings(max_error_m=0.01)
    assert broken_promises(settings, found) == []
    (told,) = changed_since_the_start(settings, found)
    assert told == "2 frames have an error bound of up to 0.200 m; the recording began with 0.010 m"
    assert found.result()["bounds_m"] == [0.01, 0.2]


def test_a_bound_that_was_tightened_on_the_way_is_held_from_there_on():
    """A frame that is off by more than its own message allows is wrong, though the bound at the start covers it."""
    found, packets = Comparison(), PacketsByTime(turning(60))
    coarse = coded(StreamSettings(max_error_m=0.2), turning(60))
    for frame, _ in coarse:
        found.add(frame, packets, Promise(11, False))
    assert any("larger errors" in text for text in broken_promises(StreamSettings(max_error_m=0.2), found))
    assert found.result()["frames_beyond_their_bound"] == 6


def test_packets_that_a_lossless_message_does_not_give_back_are_broken_whatever_was_noted():
    source = turning(60)
    wrong = bytearray(source[33].payload)
    wrong[1205] ^= 1
    decoded = coded(StreamSettings(), source)
    source[33] = Packet(bytes(wrong), source[33].stamp_ns)
    found, packets = Comparison(), PacketsByTime(source)
    for frame, promise in decoded:
        found.add(frame, packets, promise)
    assert any("1 packets differ" in text for text in broken_promises(StreamSettings(max_error_m=0.1), found))
