"""Files of maps come back as they were written, and hostile ones are refused by errors of the tree."""

from io import BytesIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec import _native
from lidarcodec.errors import (
    DecodeError,
    HeaderError,
    SectionError,
    SettingsError,
    SourceError,
    TruncatedError,
    UnsupportedVersionError,
)
from lidarcodec.maps.file import HEAD, HEAD_BYTES, MapReader, read_map, write_map
from lidarcodec.maps.points import MapFrame, MapPoints, normals_of, packed_normals
from lidarcodec.maps.tiles import Tile, decode_tile, encode_tile
from tests.maps.towns import same_points, street
from tests.sweeps import examples

TOWN = street()
BITS = [5, 5, 8]
WIDTH = 2500


def written(points):
    file = BytesIO()
    write_map(file, points)
    return file.getvalue()


def read(data):
    with MapReader(BytesIO(data)) as reader:
        return reader.points()


def test_a_map_comes_back_with_all_that_it_has():
    town = MapPoints(
        TOWN.step_m, TOWN.steps, TOWN.columns, TOWN.path, TOWN.length_m, MapFrame(32, False, (49.0, 8.4, 90.0))
    )
    back = read(written(town))
    assert same_points(town, back)
    assert (back.step_m, back.length_m, back.frame) == (0.02, 60.0, town.frame)
    assert np.abs(back.path - town.path).max() < 0.006


def test_points_far_from_the_origin_and_below_it_come_back():
    moved = MapPoints(0.02, TOWN.steps + np.array([22_805_700, 271_381_450, -3_000]), {})
    assert same_points(moved, read(written(moved)))


def test_equal_maps_give_equal_bytes_in_any_order_of_their_points():
    order = np.random.default_rng(3).permutation(len(TOWN))
    assert written(TOWN.taken(order)) == written(TOWN)


@settings(max_examples=examples(25), deadline=None)
@given(
    st.lists(st.tuples(*[st.integers(0, 2499)] * 3, st.integers(0, 31), st.integers(0, 31), st.integers(0, 255)),
             min_size=1, max_size=60, unique_by=lambda point: point[:3]),
    st.integers(-40, 40),
)  # fmt: skip
def test_any_points_come_back(rows, x):
    table = np.array(rows, np.int64)
    steps = table[:, :3] + [x * WIDTH, 0, -700]
    back = decode_tile(encode_tile(Tile(x, 0, steps, table[:, 3:].astype(np.uint16)), WIDTH, 0.02, BITS), WIDTH, BITS)
    found = np.column_stack([back.steps, back.columns])
    wanted = np.column_stack([steps, table[:, 3:]])
    assert np.array_equal(found[np.lexsort(found.T)], wanted[np.lexsort(wanted.T)])


def test_a_block_full_of_points_is_filled_up_with_zeros():
    """Its points take less than two bits each, and readers allow four points a byte."""
    full = np.stack(np.meshgrid(*[np.arange(24)] * 3), axis=-1).reshape(-1, 3).astype(np.int64)
    none = np.empty((len(full), 0), np.uint16)
    data = encode_tile(Tile(0, 0, full, none), 250, 0.2, [])
    assert len(full) / 4 <= len(data) <= len(full) / 4 + 12
    assert len(decode_tile(data, 250, []).steps) == len(full)


def test_points_that_cannot_be_kept_are_refused():
    none = np.empty((2, 0), np.uint16)
    for steps, named in (([[0, 0, 0], [0, 0, 0]], "are the same"), ([[0, 0, 0], [2500, 0, 0]], "outside"),
                         ([[0, 0, 0], [0, 0, 1 << 20]], "too high")):  # fmt: skip
        with pytest.raises(SettingsError, match=named):
            encode_tile(Tile(0, 0, np.array(steps, np.int64), none), WIDTH, 0.02, [])


def test_normals_are_kept_to_a_few_degrees():
    random = np.random.default_rng(2).normal(size=(5000, 3))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    cosine = np.abs(np.einsum("ij,ij->i", random, normals_of(*packed_normals(random))))
    assert np.degrees(np.arccos(cosine.clip(max=1))).max() < 6


def test_damage_anywhere_is_found():
    data = written(street(8.0))
    places = np.random.default_rng(4).integers(0, len(data), 300)
    for place in places:
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(place) % 8
        with pytest.raises(DecodeError):
            read(bytes(damaged))
    for length in [*range(0, HEAD_BYTES + 4, 7), *range(HEAD_BYTES, len(data), 211)]:
        with pytest.raises(DecodeError):
            read(data[:length])


def test_other_files_and_later_versions_are_named(tmp_path):
    with pytest.raises(HeaderError, match="not a map"):
        read(b"LCMAP" + bytes(400))
    later = bytearray(written(street(8.0)))
    later[8] = 2
    later[HEAD.size : HEAD_BYTES] = _native.crc32c(bytes(later[: HEAD.size])).to_bytes(4, "little")
    with pytest.raises(UnsupportedVersionError):
        read(bytes(later))
    path = tmp_path / "town.lcmap"
    path.write_bytes(bytes(later))
    with pytest.raises(SourceError, match=r"cannot read the map .*town\.lcmap"):
        read_map(path)
    with pytest.raises(SourceError, match="cannot read"):
        read_map(tmp_path / "none.lcmap")


@pytest.mark.parametrize("half", ["normal_a", "normal_b"])
def test_a_map_with_half_of_a_normal_is_refused(half):
    """`localise` and `map export` ended with an unexpected KeyError."""
    columns = {name: values for name, values in TOWN.columns.items() if name != half}
    with pytest.raises(HeaderError, match="columns that this program does not know"):
        read(written(MapPoints(TOWN.step_m, TOWN.steps, columns)))


@pytest.mark.drawn
def test_damaged_tiles_with_right_checksums_are_refused_or_decode_to_points_of_the_tile():
    town = street(8.0)
    columns = np.stack(list(town.columns.values())[:3], axis=1)
    data = encode_tile(Tile(0, 0, town.steps[town.steps[:, 1] >= 0], columns[town.steps[:, 1] >= 0]), WIDTH, 0.02, BITS)
    random, decoded = np.random.default_rng(5), 0
    for _ in range(examples(400)):
        body = bytearray(data[4:])
        for _ in range(random.integers(1, 4)):
            body[random.integers(0, min(len(body), 12 if random.random() < 0.5 else len(body)))] = random.integers(
                0, 256
            )
        if random.random() < 0.2:
            body = body[: random.integers(0, len(body))]
        try:
            tile = decode_tile(_native.crc32c(bytes(body)).to_bytes(4, "little") + bytes(body), WIDTH, BITS)
        except (TruncatedError, SectionError):
            pass
        else:
            decoded += 1
            assert len(tile.steps) <= 4 * len(data)
            assert tile.columns.max() < 256
    assert decoded < 200


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("a step of", {"step_m": 0.03}),
        ("a step of", {"step_m": 2.0}),
        ("too far", {"steps": np.array([[0, 0, 1 << 32]])}),
        ("too far", {"path": np.full((1, 3), 1e8, np.float32)}),
    ],
)
def test_what_could_not_be_read_again_is_not_written(what, changes):
    steps = changes.get("steps", np.array([[1, 2, 3]]))
    points = MapPoints(changes.get("step_m", 0.02), steps, {}, changes.get("path", np.zeros((1, 3), np.float32)), 1.0)
    with pytest.raises(SettingsError, match=what):
        write_map(BytesIO(), points)
