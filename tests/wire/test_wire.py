"""A message that is packed wrongly, or believed too early, costs a vehicle its stream."""

from __future__ import annotations

import dataclasses
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import (
    ChecksumError,
    DecodeError,
    HeaderError,
    SectionError,
    TruncatedError,
    UnsupportedVersionError,
)
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.units import MAX_COLUMNS, MAX_PACKETS
from lidarcodec.wire import pack, peek, unpack
from lidarcodec.wire.checksum import with_checksum
from tests.sweeps import examples


def message(**changes: object) -> Message:
    """A small valid message."""
    sections = (Section(SectionType.RANGE, b"abc"), Section(SectionType.MASK, b""))
    base = Message(
        codec=3, stream_id=2**64 - 1, frame_index=9, stamp_ns=-5, key=True, width=2088, packets=348, sections=sections
    )
    return dataclasses.replace(base, **changes)


def resealed(data: bytes) -> bytes:
    """The message with its size and checksum made right again."""
    body = bytearray(data[:-4])
    body[8:12] = struct.pack("<I", len(data))
    return with_checksum(bytes(body))


sections = st.lists(
    st.builds(Section, st.integers(0, 255), st.binary(max_size=40), st.just(0)),
    max_size=8,
).map(tuple)


@given(
    codec=st.integers(0, 65535),
    stream_id=st.integers(0, 2**64 - 1),
    frame_index=st.integers(1, 2**63 - 1),
    stamp_ns=st.integers(-(2**63), 2**63 - 1),
    key=st.booleans(),
    width=st.integers(0, MAX_COLUMNS),
    packets=st.integers(0, MAX_PACKETS),
    frame_count=st.integers(1, 64),
    sections=sections,
)
@settings(max_examples=examples(200), deadline=None)
def test_every_message_comes_back(frame_index, key, **fields) -> None:
    given_message = Message(frame_index=frame_index, key=key, needs=None if key else frame_index - 1, **fields)
    data = pack(given_message)
    assert unpack(data) == given_message
    assert peek(data[:56]) == peek(data)
    assert peek(data).total_bytes == len(data)


def test_the_layout_is_the_documented_one() -> None:
    data = pack(message(key=False, needs=8))
    assert len(data) == 56 + 2 * 6 + 3 + 4
    assert data[:4] == b"\x93LDC"
    assert struct.unpack_from("<BBHIHHQqQQHHHH", data, 4) == (
        1, 0, 56, len(data), 3, 2, 2**64 - 1, -5, 9, 8, 1, 2088, 348, 2,
    )  # fmt: skip
    assert data[56:62] == bytes([1, 0, 3, 0, 0, 0])


@pytest.mark.parametrize(
    "changes",
    [
        {"width": MAX_COLUMNS + 1},
        {"packets": MAX_PACKETS + 1},
        {"frame_count": 0},
        {"frame_count": 65},
        {"needs": 3},
        {"key": False, "needs": 9},
        {"stream_id": -1},
        {"codec": 65536},
        {"stamp_ns": 2**63},
        {"sections": (Section(1, b""),) * 257},
    ],
)
def test_fields_beyond_their_limits_are_not_packed(changes: dict[str, object]) -> None:
    with pytest.raises(HeaderError):
        pack(message(**changes))


@pytest.mark.parametrize("section", [Section(256, b""), Section(1, b"", 256), Section(-1, b"")])
def test_sections_that_do_not_fit_are_not_packed(section: Section) -> None:
    with pytest.raises(SectionError):
        pack(message(sections=(section,)))


def test_a_newer_major_version_is_named_even_if_all_else_differs() -> None:
    with pytest.raises(UnsupportedVersionError, match="version 2"):
        unpack(b"\x93LDC\x02 anything at all")
    with pytest.raises(UnsupportedVersionError, match="update"):
        peek(b"\x93LDC\x07")


def test_a_newer_minor_version_is_read() -> None:
    """Appended header bytes, an unknown flag of the low byte and an unknown section are all skipped."""
    sections = (Section(200, b"new"), Section(SectionType.RANGE, b"abc"))
    data = bytearray(pack(message(sections=sections)))
    data[5], data[6], data[14] = 9, 58, data[14] | 0x80
    data[56:56] = b"\1\2"
    read = unpack(resealed(bytes(data)))
    assert read.sections == sections
    assert read.section(SectionType.RANGE) == b"abc"


@pytest.mark.parametrize("bit", range(2, 8))
def test_an_unknown_critical_flag_is_refused(bit: int) -> None:
    data = bytearray(pack(message()))
    data[15] = 1 << bit
    with pytest.raises(UnsupportedVersionError, match="flags"):
        unpack(resealed(bytes(data)))


def test_the_flag_of_planes_is_read_back() -> None:
    """Without it a reader would take the packets of another sensor for those of an HDL-64E."""
    for planes in (False, True):
        data = pack(message(planes=planes))
        assert data[15] == planes
        assert unpack(data).planes is planes


def test_every_truncation_says_so() -> None:
    data = pack(message())
    for size in range(len(data)):
        with pytest.raises(TruncatedError):
            unpack(data[:size])


def test_trailing_bytes_are_refused() -> None:
    with pytest.raises(HeaderError, match="announces"):
        unpack(pack(message()) + b"\0")


def test_every_bit_flip_is_noticed() -> None:
    data = pack(message())
    for bit in range(len(data) * 8):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(DecodeError):
            unpack(bytes(flipped))


def test_a_flipped_section_byte_is_a_checksum_error() -> None:
    data = bytearray(pack(message()))
    data[-6] ^= 1
    with pytest.raises(ChecksumError):
        unpack(bytes(data))


@pytest.mark.parametrize(
    ("offset", "value", "error"),
    [
        (58, b"\xff\xff\xff\xff", TruncatedError),  # length of the first section
        (57, b"\1", SectionError),  # ordinal beyond the frames
        (54, b"\1\0", SectionError),  # fewer sections than bytes
        (54, b"\3\0", TruncatedError),  # more sections than bytes
        (50, b"\xff\xff", HeaderError),
        (52, b"\xff\xff", HeaderError),
        (48, b"\0\0", HeaderError),
        (6, b"\xff\xff", HeaderError),
        (6, b"\0\0", HeaderError),
        (40, b"\1", HeaderError),
        (14, b"\3", HeaderError),
    ],
)
def test_contradictions_behind_a_right_checksum_are_found(offset: int, value: bytes, error: type[DecodeError]) -> None:
    data = bytearray(pack(message()))
    data[offset : offset + len(value)] = value
    with pytest.raises(error):
        unpack(resealed(bytes(data)))


@given(st.binary(max_size=120))
@settings(max_examples=examples(300), deadline=None)
def test_random_bytes_are_refused(noise: bytes) -> None:
    for data in (noise, b"\x93LDC\x01" + noise, pack(message())[:56] + noise):
        with pytest.raises(DecodeError):
            unpack(data)
