"""What a user loses if these fail: the very messages of his bag, or the room that they were to save."""

from __future__ import annotations

import time

import numpy as np
import pytest
import zstandard

from lidarcodec import _native
from lidarcodec.entropy import fast
from lidarcodec.entropy.varint import VarintReader
from lidarcodec.errors import DecodeError, SectionError
from lidarcodec.image_frame import cloud_frame
from lidarcodec.planes.clouds import section
from lidarcodec.planes.clouds.column_decoder import decode_column
from lidarcodec.planes.clouds.columns import Image, Way, put_sized
from lidarcodec.planes.clouds.comparison import same_but_near
from lidarcodec.planes.clouds.geometry import cosine_sine, from_ordered, ordered
from lidarcodec.planes.clouds.section import COLUMNS, ZSTD, CloudBefore, bound_of_cloud, decode_cloud, encode_cloud
from lidarcodec.planes.plane_section import PlaneKind
from lidarcodec.sensors.clouds.grid import grid_of, places_of
from lidarcodec.sensors.clouds.message import read_head, read_message
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from tests.planes.cloud_messages import CLOUDS, OUSTER, VELODYNE
from tests.point_clouds import message, ouster, ros1, velodyne


@pytest.mark.parametrize("kind", list(PlaneKind), ids=lambda kind: kind.name)
@pytest.mark.parametrize("payload", CLOUDS.values(), ids=CLOUDS)
def test_every_message_comes_back_byte_for_byte(payload, kind):
    assert decode_cloud(encode_cloud(payload, kind)).payload == payload


@pytest.mark.parametrize("bound_m", [0.002, 0.05])
@pytest.mark.parametrize("payload", CLOUDS.values(), ids=CLOUDS)
def test_with_a_bound_no_point_is_further_off_and_every_other_byte_stays(payload, bound_m):
    section = encode_cloud(payload, PlaneKind.QUICK, bound_m)
    back = decode_cloud(section).payload
    assert same_but_near(back, payload, bound_m)
    assert back == payload or bound_of_cloud(section) == pytest.approx(bound_m, abs=1e-6)


def test_a_point_beyond_the_bound_or_another_field_is_noticed():
    points = velodyne(20)
    other = points.copy()
    other["y"][3] += 0.02
    assert same_but_near(message(other), message(points), 0.021)
    assert not same_but_near(message(other), message(points), 0.019)
    other["time"][0] = 1.0
    assert not same_but_near(message(other), message(points), 1.0)


@pytest.mark.parametrize(("payload", "most"), [(VELODYNE, 22.0), (OUSTER, 22.0)], ids=["velodyne", "ouster"])
def test_a_cloud_needs_a_fraction_of_what_zstd_makes_of_it(payload, most):
    """Sensors measure in whole steps: found, nothing but those and some rounding of float32 is left."""
    points = int(np.count_nonzero(read_message(payload).returns))
    section = encode_cloud(payload, PlaneKind.MODELLED)
    assert section[0] == COLUMNS
    assert len(section) * 8 / points < most
    assert 3 * len(section) < len(zstandard.ZstdCompressor(19).compress(payload))


def test_a_bound_saves_room():
    exact, bounded = (encode_cloud(VELODYNE, PlaneKind.MODELLED, bound) for bound in (None, 0.01))
    assert len(bounded) < 0.8 * len(exact)


def test_random_bytes_travel_as_they_are():
    payload = np.random.default_rng(3).bytes(5000)
    section = encode_cloud(payload, PlaneKind.MODELLED)
    assert section[0] == ZSTD
    assert len(section) < 5100
    assert decode_cloud(section).payload == payload


def test_the_largest_clouds_come_back():
    points = np.zeros(400_000, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    points["x"] = np.arange(400_000) % 1000
    payload = message(points)
    assert decode_cloud(encode_cloud(payload, PlaneKind.ZSTD)).payload == payload
    with pytest.raises(SectionError, match="limit"):
        encode_cloud(bytes(33 * 2**20), PlaneKind.ZSTD)


def test_mutated_messages_come_back_too():
    rng = np.random.default_rng(11)
    small = [message(velodyne(30)), message(ouster(32), 16), ros1(message(velodyne(10)))]
    for number in range(120):
        payload = bytearray(small[number % len(small)])
        head = read_head(bytes(payload)).size
        for _ in range(int(rng.integers(1, 4))):
            payload[int(rng.integers(0, head if rng.random() < 0.7 else len(payload)))] = int(rng.integers(0, 256))
        if rng.random() < 0.2:
            payload = payload[: int(rng.integers(0, len(payload)))]
        kind = (PlaneKind.ZSTD, PlaneKind.QUICK)[number % 2]
        assert decode_cloud(encode_cloud(bytes(payload), kind)).payload == payload


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", [PlaneKind.ZSTD, PlaneKind.QUICK], ids=["zstd", "quick"])
def test_damaged_sections_are_refused_or_give_some_message(kind):
    rng = np.random.default_rng(12)
    for payload in (message(velodyne(30)), message(ouster(32), 16)):
        section = encode_cloud(payload, kind)
        for number in range(150):
            damaged = bytearray(section)
            if number % 3:
                damaged[int(rng.integers(0, len(damaged)))] ^= 1 << int(rng.integers(0, 8))
            else:
                del damaged[int(rng.integers(0, len(damaged))) :]
            try:
                decode_cloud(bytes(damaged))
            except DecodeError:
                continue


@pytest.mark.parametrize("payload", CLOUDS.values(), ids=CLOUDS)
def test_no_two_points_share_a_cell_and_their_order_is_known(payload):
    try:
        found = read_message(payload)
    except DecodeError:
        return
    grid = grid_of(found)
    if grid is None:
        return
    row, column = places_of(grid.mask(), grid.firing, by_column=grid.by_column)
    assert np.array_equal(row, grid.row)
    assert np.array_equal(column, grid.column)


def test_columns_are_those_that_fired_though_returns_are_missing():
    grid = grid_of(read_message(VELODYNE))
    assert grid is not None
    assert (grid.rows, grid.columns, grid.by_column) == (16, 300, True)
    assert grid.firing.tolist() in [[*range(k, 16, 2), *range(1 - k, 16, 2)] for k in (0, 1)] or grid.columns == 300


def test_sines_need_no_library_and_are_as_good():
    turns = np.linspace(-3, 3, 10_001)
    cosine, sine = cosine_sine(turns)
    assert np.abs(cosine - np.cos(2 * np.pi * turns)).max() < 1e-14
    assert np.abs(sine - np.sin(2 * np.pi * turns)).max() < 1e-14


def test_float32_in_order_go_there_and_back():
    bits = np.random.default_rng(1).integers(0, 2**32, 5000, dtype=np.uint32)
    values = np.concatenate((bits, np.array([0, 1 << 31, 0x7F800000, 0xFF800000], np.uint32))).view(np.float32)
    assert np.array_equal(from_ordered(ordered(values)).view(np.uint32), values.view(np.uint32))
    assert np.array_equal(ordered(np.array([-1e-45, -0.0, 0.0, 1e-45], np.float32)), [-2, -1, 0, 1])


@pytest.mark.parametrize("over", ["z", "intensity", "y"])
def test_a_bound_holds_where_coordinates_lie_over_other_fields(over):
    """No driver sends that. What is written last of the two would be off by more than the bound."""
    points = velodyne(60)
    names = list(points.dtype.names)
    dtype = np.dtype(
        {
            "names": names,
            "formats": [points.dtype[name] for name in names],
            "offsets": [0 if name == "x" else 2 if name == over else 4 * (1 + at) for at, name in enumerate(names)],
            "itemsize": 40,
        }
    )
    packed = np.zeros(len(points), dtype)
    for name in names[::-1]:
        packed[name] = points[name]
    payload = message(packed)
    for bound_m in (None, 0.02, 1.0):
        back = decode_cloud(encode_cloud(payload, PlaneKind.QUICK, bound_m)).payload
        assert same_but_near(back, payload, bound_m or 0.0)


@pytest.mark.parametrize("pattern", [0x7FA00001, 0xFFA00001, 0x7FC00000, 0x7F800000])
def test_numbers_that_are_none_are_no_returns_and_warn_of_nothing(pattern):
    """Signalling NaN, too, of which a processor tells when they are converted."""
    points = velodyne(12, 8)
    points["x"][:3] = np.full(3, pattern, np.uint32).view(np.float32)
    data = message(points)
    frame = cloud_frame(0, 0, data, cloud_sensor([data]))
    assert frame.points <= len(points) - 3
    assert len(frame.cloud("all")) == len(points) - 3


@pytest.mark.parametrize("number", [1e300, -1e39, np.nan, np.inf])
def test_coordinates_of_64_bits_that_no_32_hold_warn_of_nothing(number):
    points = np.zeros(60 * 16, [(name, "<f8") for name in "xyz"])
    turn = np.repeat(np.arange(60) * 2 * np.pi / 60, 16)
    points["x"], points["y"], points["z"] = 9 * np.cos(turn), 9 * np.sin(turn), np.tile(np.arange(16) - 8.0, 60)
    points["x"][100] = number
    with np.errstate(all="raise"):
        assert grid_of(read_message(message(points))) is not None


@pytest.mark.parametrize("bound_m", [None, 0.02])
def test_coordinates_that_a_broken_coder_wrote_do_not_leave_the_encoder(monkeypatch, bound_m):
    payloads = [message(velodyne(60, seed=seed)) for seed in range(18)]
    coder = _native.encode_points

    def broken(*given):
        data, *others = coder(*given)
        return (bytes([*data[:-1], data[-1] ^ 1]), *others)

    before = CloudBefore()
    made = [encode_cloud(payloads[0], PlaneKind.QUICK, bound_m, before)]
    monkeypatch.setattr(_native, "encode_points", broken)
    made += [encode_cloud(one, PlaneKind.QUICK, bound_m, before) for one in payloads[1:]]
    alone = encode_cloud(payloads[1], PlaneKind.QUICK, bound_m)
    assert decode_cloud(alone).payload == payloads[1]
    assert made[0][0] == COLUMNS
    assert [one[0] for one in made[16:]] == [ZSTD, ZSTD]  # one in sixteen is decoded, and all behind a wrong one
    assert decode_cloud(made[17]).payload == payloads[17]


def test_sums_of_the_least_number_of_64_bits_are_refused():
    frame_grid = grid_of(read_message(message(velodyne(12, 8))))
    nothing = np.zeros(len(frame_grid.row), np.int64)
    data = bytearray(8)
    for count, number in ((frame_grid.columns, -(2**63)), (frame_grid.rows, -1)):
        coded = fast.encode_signed((np.full(count, number),))
        data += bytes(3)  # numbers as they are, of a level line at 0
        put_sized(data, coded)
    put_sized(data, b"\0")
    image = Image(frame_grid, None, nothing, nothing)
    with pytest.raises(SectionError, match="60 bits"):
        decode_column(Way.SUMS, VarintReader(bytes(data)), np.dtype("<i8"), len(nothing), image, None)


def test_points_of_millions_of_bytes_cost_no_more_than_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """A message of 763 bytes took a decoder 7 s of processor and 3.7 GB: a column for each byte of a point."""
    kind = np.dtype({"names": ["x", "y", "z"], "formats": ["<f4"] * 3, "offsets": [0, 4, 8], "itemsize": 1 << 20})
    payload = message(np.zeros(2, kind))
    began_s = time.process_time()
    coded = encode_cloud(payload, PlaneKind.QUICK)
    assert decode_cloud(coded).payload == payload
    assert (coded[0], len(coded) < 1000) == (ZSTD, True)
    assert time.process_time() - began_s < 1.0
    monkeypatch.setattr(section, "MAX_STEP", 1 << 20)
    hostile = encode_cloud(payload, PlaneKind.QUICK)
    assert hostile[0] == COLUMNS
    monkeypatch.undo()
    with pytest.raises(SectionError, match="points of 1048576 bytes"):
        decode_cloud(hostile)
