"""Side information: without it packets cannot be rebuilt byte for byte, and it must not cost more than it tells."""

from __future__ import annotations

import doctest
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import decode_side, encode_side, fast, number_series, side_coder
from lidarcodec.errors import DecodeError, SectionError, TruncatedError
from lidarcodec.side import SideInfo
from tests.entropy.frames import frames, s2_side, same_side
from tests.reference import series as reference_series
from tests.sweeps import examples

GOLDEN = Path(__file__).parent.parent / "golden"


@st.composite
def sides(draw: st.DrawFn) -> SideInfo:
    """Side information of any kind, from plain to noise, each part by itself."""
    packets = draw(st.integers(0, 50))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    pick = draw(st.lists(st.sampled_from(["plain", "near", "noise"]), min_size=5, max_size=5))
    ramp = np.arange(packets)
    host = {
        "plain": ramp * 288_000,
        "near": ramp * 288_000 + rng.integers(-5000, 5000, packets),
        "noise": rng.integers(-(2**60) + 1, 2**60, packets),
    }[pick[0]]
    gps = {
        "plain": (3_599_999_000 + ramp * 288) % 3_600_000_000,
        "near": np.where(ramp % 2, 0x6544204F, 0x32760C21) + rng.integers(0, 2, packets),
        "noise": rng.integers(0, 2**32, packets),
    }[pick[1]]
    cycle = rng.integers(0, 256, 16)
    types = {
        "plain": np.resize(cycle, packets),
        "near": np.resize(cycle[:7], packets) ^ (rng.random(packets) < 0.05),
        "noise": rng.integers(0, 256, packets),
    }[pick[2]]
    values = types * 3 % 256 if pick[3] == "plain" else rng.integers(0, 256, packets)
    layouts, layout = SideInfo.regular(0).layouts, np.zeros(packets, np.uint16)
    if pick[4] != "plain":
        layouts = rng.integers(0, 7 if pick[4] == "near" else 256, (draw(st.integers(1, packets + 1)), 12)).astype(
            np.uint8
        )
        layout = rng.integers(0, len(layouts), packets).astype(np.uint16)
    irregular = draw(st.integers(0, 12 * packets))
    second = draw(st.integers(0, 12 * packets - irregular))
    return SideInfo(
        packet_ns=host.astype(np.int64),
        gps_us=gps.astype(np.uint32),
        status=np.stack([types, values], axis=1).astype(np.uint8),
        layouts=layouts,
        layout=layout,
        irregular=rng.integers(0, 256, (irregular, 100)).astype(np.uint8),
        second=rng.integers(0, draw(st.sampled_from([1, 3, 256])), (second, 96)).astype(np.uint8),
    )


@settings(max_examples=examples(150), deadline=None)
@given(sides())
def test_any_side_information_comes_back(side):
    assert same_side(decode_side(encode_side(side, host_step_ns=1), side.packets), side)


@settings(max_examples=examples(50), deadline=None)
@given(sides(), st.sampled_from([10, 1000, 1_000_000]))
def test_host_times_are_rounded_to_their_step_and_nothing_else_is(side, step):
    decoded = decode_side(encode_side(side, host_step_ns=step), side.packets)
    assert same_side(decoded, replace(side, packet_ns=(side.packet_ns + step // 2) // step * step))


_EDGES = st.sampled_from([0, 1, -1, 2**62, -(2**62), 2**63 - 1, -(2**63), 3_600_000_000])
_NUMBERS = st.one_of(st.integers(-(2**63), 2**63 - 1), st.integers(-1000, 1000), _EDGES)


@settings(max_examples=examples(300), deadline=None)
@given(st.lists(_NUMBERS, max_size=40), st.sampled_from([0, 256, 3_600_000_000, 1 << 32]))
def test_the_form_of_a_series_is_the_reference_s_and_tells_all_of_it(values, modulus):
    values = [value % modulus for value in values] if modulus else values
    series = np.array(values, np.int64)
    fit, (form, line, left, cost) = fast.best_form(series, modulus), reference_series.best_form(series, modulus)
    assert (fit.form, fit.line, fit.left.tolist(), fit.cost) == (form, line, left.tolist(), cost)
    back = number_series.series(fit.left, fit.form, fit.line)
    assert (back % modulus if modulus else back).tolist() == values


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.integers(0, 3), max_size=80), st.integers(1, 32))
def test_the_period_of_types_is_the_reference_s(types, longest):
    assert fast.best_period(np.array(types, np.uint8), longest) == reference_series.best_period(types, longest)


@pytest.mark.parametrize("longest", [0, 33, 1 << 31, (1 << 64) - 1])
def test_a_search_for_a_period_ends(longest):
    with pytest.raises(SectionError, match="a period of types is 1 to 32 packets long"):
        fast.best_period(np.zeros(64, np.uint8), longest)


def test_an_s2_costs_at_most_400_bytes_a_frame():
    side = s2_side(jitter_ns=1000)
    data = encode_side(side)
    assert len(data) <= 400  # 152 of them are calibration bytes that nothing foretells
    assert same_side(decode_side(data, 348), replace(side, packet_ns=(side.packet_ns + 500) // 1000 * 1000))


def test_what_is_regular_costs_next_to_nothing():
    assert len(encode_side(SideInfo.regular(348))) < 30
    assert len(encode_side(SideInfo.regular(0))) < 30


def test_an_hour_that_ends_costs_nothing():
    side = s2_side()
    before = replace(side, gps_us=(np.arange(348) * 288 + 1_000_000).astype(np.uint32))
    assert side.gps_us.min() < 1000
    assert len(encode_side(side)) < len(encode_side(before)) + 20


def test_a_period_of_status_types_is_found():
    side = s2_side(0)
    shuffled = side.status.copy()
    np.random.default_rng(1).shuffle(shuffled)
    assert len(encode_side(side)) < len(encode_side(replace(side, status=shuffled))) - 100


def test_two_clocks_that_drift_apart_cost_little():
    side = s2_side(0)
    drifting = replace(side, packet_ns=side.packet_ns * 100_005 // 100_000)
    assert len(encode_side(drifting)) < len(encode_side(side)) + 60


def test_noise_costs_no_more_than_it_is():
    rng = np.random.default_rng(1)
    side = replace(
        SideInfo.regular(348),
        gps_us=rng.integers(0, 2**32, 348).astype(np.uint32),
        status=rng.integers(0, 256, (348, 2)).astype(np.uint8),
        irregular=rng.integers(0, 256, (2000, 100)).astype(np.uint8),
    )
    assert len(encode_side(side)) < 1.15 * 348 * 6 + 200_050


def test_blocks_whose_compressed_size_is_their_own_come_back():
    """A zstd frame as long as the blocks themselves must not be taken for them."""
    same_size = False
    for zeros in range(60):
        block = np.random.default_rng(1).integers(1, 256, (1, 100)).astype(np.uint8)
        block[:, 100 - zeros :] = 0
        same_size |= len(zstandard.ZstdCompressor(level=3).compress(block.tobytes())) == block.size
        side = replace(SideInfo.regular(1), layouts=np.array([[1, 4] * 5 + [1, 0]], np.uint8), irregular=block)
        assert same_side(decode_side(encode_side(side), 1), side)
    assert same_size


def test_second_returns_are_compressed():
    second = np.zeros((348 * 4, 96), np.uint8)
    second[:, ::3] = 17
    side = replace(SideInfo.regular(348), second=second)
    assert len(encode_side(side)) < 1000


@pytest.mark.parametrize(
    "changes",
    [
        {"layouts": np.zeros((9, 12), np.uint8)},
        {"irregular": np.zeros((40, 100), np.uint8), "second": np.zeros((9, 96), np.uint8)},
        {"packet_ns": np.array([0, 0, 2**61, 0], np.int64)},
        {"packet_ns": np.array([-(2**63), 0, 0, 0], np.int64)},
    ],
)
def test_what_no_frame_can_hold_is_refused(changes):
    with pytest.raises(SectionError):
        encode_side(replace(SideInfo.regular(4), **changes))


@pytest.mark.parametrize("step", [0, -1, 10**10])
def test_a_step_of_no_use_is_refused(step):
    with pytest.raises(SectionError):
        encode_side(SideInfo.regular(4), host_step_ns=step)


@settings(max_examples=examples(300), deadline=None)
@given(st.binary(max_size=120), st.integers(-1, 60))
def test_any_bytes_give_side_information_or_an_error_of_the_tree(data, packets):
    with suppress(SectionError, TruncatedError):
        assert decode_side(data, packets).packets == packets


@settings(max_examples=examples(200), deadline=None)
@given(sides(), st.data())
def test_damaged_bytes_give_side_information_or_an_error_of_the_tree(side, data):
    encoded = bytearray(encode_side(side)[:300])
    for _ in range(data.draw(st.integers(1, 3))):
        encoded[data.draw(st.integers(0, len(encoded) - 1))] = data.draw(st.integers(0, 255))
    with suppress(SectionError, TruncatedError):
        assert decode_side(bytes(encoded), side.packets).packets == side.packets


def test_no_cut_passes_for_the_whole():
    side = replace(s2_side(packets=40), irregular=np.zeros((3, 100), np.uint8))
    data = encode_side(side)
    for cut in range(len(data)):
        with suppress(DecodeError):
            assert not same_side(decode_side(data[:cut], 40), decode_side(data, 40))
    with pytest.raises(SectionError):
        decode_side(data + b"\0", 40)


def test_a_small_section_takes_no_large_memory():
    regular = bytearray(encode_side(SideInfo.regular(4)))
    assert regular[-2:] == b"\0\0"  # no irregular blocks and no second returns beyond those that the layouts announce
    with pytest.raises(SectionError, match=r"too many|over"):
        decode_side(bytes(regular[:-2]) + b"\xa0\x9c\x01\0", 4)
    bomb = zstandard.ZstdCompressor().compress(bytes(10**8))
    for blocks in (b"\x50\0", b"\0\x50"):  # 40 of them
        with pytest.raises(SectionError, match="bytes"):
            decode_side(bytes(regular[:-2]) + blocks + bomb, 4)
    unsized = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(4000))
    with pytest.raises(SectionError):
        decode_side(bytes(regular[:-2]) + b"\x50\0" + unsized, 4)


def golden_case() -> SideInfo:
    place = np.arange(48)
    return SideInfo(
        packet_ns=place * 288_000 + place % 5 * 1000,
        gps_us=((3_599_995_000 + place * 288 + place % 3) % 3_600_000_000).astype(np.uint32),
        status=np.stack([place % 7 + 65, place * place % 11], axis=1).astype(np.uint8),
        layouts=np.array([[3, 2, 1, 1] * 3, [1, 4] * 6, [1, 4, 5, 6] * 2 + [0] * 4], np.uint8),
        layout=(place % 16 == 0).astype(np.uint16) + (place == 20) * np.uint16(2),
        irregular=(np.arange(400) % 251).astype(np.uint8).reshape(4, 100),
        second=(np.arange(384) * 7 % 256).astype(np.uint8).reshape(4, 96),
    )


def test_golden_bytes():
    golden = (GOLDEN / "entropy_side.bin").read_bytes()
    assert same_side(decode_side(golden, 48), golden_case())


def test_real_captures(data_file):
    for name in ("kitti_sfnd_f000-049.pcap.xz", "hdl64e_s3_atwall.pcap"):
        for frame in frames(data_file(name), data_file("kitti_hdl64e_s2_recovered.yaml"), 2):
            assert frame.side is not None
            data = encode_side(frame.side)
            assert len(data) < 400
            assert same_side(decode_side(data, frame.side.packets), frame.side)


def test_documentation_example():
    assert doctest.testmod(side_coder).failed == 0
