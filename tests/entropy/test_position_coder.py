"""Position packets: where the car was. They must come back byte for byte, and hostile ones must take no memory."""

from __future__ import annotations

import doctest
import random
import tracemalloc
from contextlib import suppress

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import decode_positions, encode_positions, position_coder
from lidarcodec.errors import DecodeError, SectionError, TruncatedError
from lidarcodec.side import Position, SideInfo
from lidarcodec.units import MAX_POSITION_BYTES, MAX_POSITIONS
from tests import positions
from tests.fuzz.mutations import mutated
from tests.sweeps import examples

FRAME = positions.of_frame(348, every=14)


@st.composite
def any_positions(draw: st.DrawFn) -> tuple[Position, ...]:
    """Position packets of any kind, up to forty."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    count = draw(st.integers(1, 40))
    places = np.sort(rng.integers(0, 100, count)).tolist()
    offsets = draw(st.lists(st.integers(-(2**62) + 1, 2**62 - 1), min_size=count, max_size=count))
    sizes = rng.choice(draw(st.sampled_from([[512], [0, 1, 512, 512, MAX_POSITION_BYTES]])), count).tolist()
    return tuple(Position(at, ns, rng.bytes(size)) for at, ns, size in zip(places, offsets, sizes, strict=True))


@given(any_positions())
@settings(max_examples=examples(60), deadline=None)
def test_whatever_comes_comes_back(sent: tuple[Position, ...]) -> None:
    assert decode_positions(encode_positions(sent, host_step_ns=1), 100) == sent


def test_host_times_are_rounded_as_those_of_data_packets() -> None:
    sent = tuple(one._replace(offset_ns=one.offset_ns + 499) for one in FRAME)
    assert decode_positions(encode_positions(sent), 348) == FRAME


def test_a_turn_of_them_costs_next_to_nothing() -> None:
    turn = tuple(
        Position(14 * k, 4_032_000 * k, positions.payload(1_700_000_000 * 10**9 + 4_032_000 * k)) for k in range(25)
    )
    assert len(encode_positions(turn)) < 800  # 64 kbit/s of 1 Mbit/s


def test_what_no_frame_may_hold_is_refused_before_it_is_sent() -> None:
    def side(*sent: Position) -> SideInfo:
        plain = SideInfo.regular(2)
        return SideInfo(
            plain.packet_ns,
            plain.gps_us,
            plain.status,
            plain.layouts,
            plain.layout,
            plain.irregular,
            plain.second,
            sent,
        )

    assert side(Position(2, 0, b"")).positions
    with pytest.raises(SectionError, match="place 3"):
        side(Position(3, 0, b""))
    with pytest.raises(SectionError, match="place 1 after 2"):
        side(Position(2, 0, b""), Position(1, 0, b""))
    with pytest.raises(SectionError, match="1473 bytes"):
        side(Position(0, 0, bytes(1473)))
    with pytest.raises(SectionError, match="the limit is 2048"):
        side(*[Position(0, 0, b"")] * (MAX_POSITIONS + 1))
    with pytest.raises(SectionError, match="1049600 bytes"):
        side(*[Position(0, 0, bytes(1025))] * 1024)
    with pytest.raises(SectionError, match="146 years"):
        encode_positions((Position(0, 2**62, b""),))
    with pytest.raises(SectionError, match="0 position packets"):
        encode_positions(())


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"", TruncatedError),
        (b"\2", SectionError),
        (b"\0\0", SectionError),
        (b"\1\0", SectionError),
        (b"\0\x81\x10", SectionError),
        (b"\0\xff\xff\xff\xff\xff\xff\xff\xff\xff\1", SectionError),
        (b"\0\1\1\4", SectionError),
        (b"\0\1\1\0\0\0\5", TruncatedError),
    ],
)
def test_hostile_heads_are_refused(data: bytes, error: type[Exception]) -> None:
    with pytest.raises(error):
        decode_positions(data, 348)


def test_differences_need_payloads_of_one_size() -> None:
    for sent in ((Position(0, 0, b"a"), Position(0, 0, b"bc")), (Position(0, 0, b""),) * 2):
        data = encode_positions(sent)
        assert data[0] == 0
        with pytest.raises(SectionError, match="one size"):
            decode_positions(b"\1" + data[1:], 1)


def test_more_places_than_packets_are_refused() -> None:
    with pytest.raises(SectionError, match="in a frame of 347 packets"):
        decode_positions(encode_positions(FRAME), 347)


def test_a_bomb_is_refused_by_the_size_that_it_says() -> None:
    data = encode_positions((Position(0, 0, bytes(512)),) * 3)
    head = data[: data.index(b"\x28\xb5\x2f\xfd")]
    bomb = zstandard.ZstdCompressor(level=1).compress(bytes(1 << 28))
    tracemalloc.start()
    with pytest.raises(SectionError, match=r"not 1536 bytes|limit|bytes after"):
        decode_positions(head + bomb[:1500], 348)
    with pytest.raises(SectionError, match="bytes after the end"):
        decode_positions(data + bytes(2000), 348)
    assert tracemalloc.get_traced_memory()[1] < 4 << 20
    tracemalloc.stop()


@pytest.mark.drawn
def test_every_cut_and_any_damage_gives_our_error_or_other_packets() -> None:
    data, rng = encode_positions(FRAME), random.Random(3)
    for size in range(len(data)):
        with pytest.raises(DecodeError):
            decode_positions(data[:size], 348)
    for _ in range(examples(3000)):
        with suppress(DecodeError):
            came = decode_positions(mutated(data, rng), 348)
            assert sum(len(one.payload) for one in came) <= 1 << 20


def test_the_example_in_the_module_is_true() -> None:
    assert doctest.testmod(position_coder).failed == 0
