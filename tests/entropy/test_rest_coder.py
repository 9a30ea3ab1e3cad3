"""What a user would lose here: a packet's time stamp or an odd packet; and a receiver to bytes of a stranger."""

from __future__ import annotations

import contextlib
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lidarcodec.entropy.rest_coder import MAX_SERIES_NUMBERS, decode_rest, encode_rest
from lidarcodec.errors import DecodeError, SectionError
from lidarcodec.packet_rest import MAX_ODD_BYTES, MAX_SERIES, PacketRest
from lidarcodec.units import MAX_PACKETS
from tests.fuzz.mutations import mutated
from tests.sweeps import examples

NAMES = st.text("abcxyz_019", max_size=16)
NUMBERS = st.sampled_from([np.uint8, np.uint16, np.uint32, np.uint64]).flatmap(
    lambda kind: hnp.arrays(kind, st.integers(0, 40))
)
NO_ODD = np.zeros(0, np.uint16)


@st.composite
def rests(draw: st.DrawFn) -> PacketRest:
    """The rest of up to 40 packets."""
    packets = draw(st.integers(0, 40))
    odd = sorted(draw(st.sets(st.integers(0, packets - 1)))) if packets else []
    return PacketRest(
        draw(NAMES),
        draw(hnp.arrays(np.int64, packets, elements=st.integers(-(2**59), 2**59))),
        np.array(odd, np.uint16),
        tuple(draw(st.binary(max_size=60)) for _ in odd),
        draw(st.dictionaries(NAMES, NUMBERS, max_size=4)),
    )


def assert_equal(found: PacketRest, rest: PacketRest) -> None:
    assert found.layout == rest.layout
    assert found.odd_packets == rest.odd_packets
    np.testing.assert_array_equal(found.odd, rest.odd)
    assert list(found.series) == list(rest.series)
    for name, values in rest.series.items():
        assert found.series[name].dtype == values.dtype
        np.testing.assert_array_equal(found.series[name], values)


@settings(deadline=None)
@given(rests(), st.integers(1, 10**9))
def test_all_comes_back_and_times_are_rounded_to_the_step(rest: PacketRest, step: int) -> None:
    found = decode_rest(encode_rest(rest, host_step_ns=step), rest.packets)
    assert_equal(found, rest)
    assert np.all(np.abs(found.packet_ns - rest.packet_ns) <= step // 2)
    np.testing.assert_array_equal(
        decode_rest(encode_rest(rest, host_step_ns=1), rest.packets).packet_ns, rest.packet_ns
    )


@settings(deadline=None, max_examples=examples(300))
@given(st.binary(max_size=200), st.integers(0, MAX_PACKETS))
def test_bytes_of_a_stranger_are_decode_errors(data: bytes, packets: int) -> None:
    with contextlib.suppress(DecodeError):
        decode_rest(data, packets)


@settings(deadline=None)
@given(rests(), st.integers(0, 2**32))
def test_damaged_bytes_are_decode_errors(rest: PacketRest, seed: int) -> None:
    data, rng = encode_rest(rest), random.Random(seed)
    for _ in range(20):
        with contextlib.suppress(DecodeError):
            decode_rest(mutated(data, rng), rest.packets)


@settings(deadline=None, max_examples=examples(20))
@given(rests())
def test_every_cut_and_every_addition_is_damage(rest: PacketRest) -> None:
    data = encode_rest(rest)
    for end in range(len(data)):
        with pytest.raises(DecodeError):
            decode_rest(data[:end], rest.packets)
    with pytest.raises(SectionError):
        decode_rest(data + b"\0", rest.packets)


def test_regular_series_take_next_to_nothing() -> None:
    """A turn of a VLP-16 has 75 packets; their stamps must not cost what they take in the packets."""
    stamps = np.arange(75, dtype=np.uint32) * 1327 + 7
    rest = PacketRest("single", np.arange(75) * 1_327_000, NO_ODD, (), {"time_us": stamps})
    assert len(encode_rest(rest)) < 50


def test_odd_packets_that_hardly_change_are_small() -> None:
    one = random.Random(1).randbytes(1000)
    packets = tuple(bytes([k]) + one for k in range(100))
    rest = PacketRest("", np.zeros(100, np.int64), np.arange(100, dtype=np.uint16), packets)
    assert len(encode_rest(rest)) < 2000


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"odd": np.array([1, 0], np.uint16), "odd_packets": (b"", b"")}, "not ascending"),
        ({"odd": np.array([0, 9], np.uint16), "odd_packets": (b"", b"")}, "beyond the 4"),
        ({"odd": np.array([0], np.uint16), "odd_packets": ()}, "1 places of 0 odd packets"),
        ({"odd": np.array([0], np.uint16), "odd_packets": (bytes(MAX_ODD_BYTES + 1),)}, "the limits are"),
        ({"series": {str(k): np.zeros(0, np.uint8) for k in range(MAX_SERIES + 1)}}, "the limit is 64"),
        ({"packet_ns": np.zeros(MAX_PACKETS + 1, np.int64)}, "the limit is 2048"),
    ],
)
def test_a_rest_beyond_the_limits_cannot_be_made(changes: dict[str, object], why: str) -> None:
    usual: dict[str, object] = {"layout": "", "packet_ns": np.zeros(4, np.int64), "odd": NO_ODD, "odd_packets": ()}
    with pytest.raises(SectionError, match=why):
        PacketRest(**{**usual, **changes})  # type: ignore[arg-type]


def test_more_numbers_than_a_frame_may_have_are_refused_before_they_take_memory() -> None:
    many = np.zeros(MAX_SERIES_NUMBERS + 1, np.uint8)
    with pytest.raises(SectionError, match="numbers in a frame"):
        encode_rest(PacketRest("", np.zeros(1, np.int64), NO_ODD, (), {"many": many}))
    fitting = encode_rest(PacketRest("", np.zeros(1, np.int64), NO_ODD, (), {"one": np.zeros(1, np.uint8)}))
    place = fitting.index(b"\3one") + 5
    with pytest.raises(DecodeError):
        decode_rest(fitting[:place] + b"\xff\xff\xff\x7f" + fitting[place + 1 :], 1)


def test_times_a_lifetime_apart_are_refused() -> None:
    with pytest.raises(SectionError, match="36 years"):
        encode_rest(PacketRest("", np.array([0, 2**61]), NO_ODD, ()))
