"""What a user would lose here: a cell of an image, the promised bound, or a receiver to bytes of a stranger."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lidarcodec.errors import DecodeError, SectionError
from lidarcodec.planes.plane_section import (
    MAX_BITS,
    PlaneKind,
    decode_plane_section,
    encode_plane_section,
    read_head,
)
from lidarcodec.sensors.images import Plane, Unsigned
from tests.fuzz.mutations import mutated
from tests.sweeps import examples

KINDS = tuple(PlaneKind)
RANGE = Plane("range", 16, "range")


@st.composite
def images(draw: st.DrawFn) -> tuple[tuple[Plane, ...], dict[str, Unsigned], np.ndarray]:
    """Forms, planes and shifts of up to 8 x 24 cells."""
    rows, columns = draw(st.integers(1, 8)), draw(st.integers(0, 24))
    wide = draw(st.integers(1, MAX_BITS))
    forms = [Plane("range", wide, "range")]
    if draw(st.booleans()):
        forms.append(Plane("range2", wide, "second range", "range2"))
    for name in draw(st.lists(st.sampled_from(["intensity", "intensity2", "signal"]), unique=True)):
        forms.append(Plane(name, draw(st.integers(1, MAX_BITS)), "attribute", draw(st.sampled_from(forms)).of))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    planes: dict[str, Unsigned] = {}
    for form in forms:
        values = rng.integers(0, 1 << form.bits, (rows, columns)) * (rng.random((rows, columns)) < rng.random())
        planes[form.name] = values.astype(form.dtype)
    return tuple(forms), planes, rng.integers(-30, 30, rows).astype(np.int32)


def back(
    kind: PlaneKind, forms: tuple[Plane, ...], planes: Mapping[str, Unsigned], shift: np.ndarray, step: int = 1
) -> dict[str, Unsigned]:
    section = encode_plane_section(kind, forms, planes, shift, step)
    assert read_head(section).forms == forms
    return decode_plane_section(section, planes["range"].shape[1])


@settings(deadline=None)
@given(images(), st.sampled_from(KINDS))
def test_every_cell_comes_back_in_the_type_of_its_plane(made, kind: PlaneKind) -> None:
    forms, planes, shift = made
    found = back(kind, forms, planes, shift)
    assert list(found) == [form.name for form in forms]
    for form in forms:
        assert found[form.name].dtype == form.dtype
        np.testing.assert_array_equal(found[form.name], planes[form.name])


@settings(deadline=None)
@given(images(), st.sampled_from(KINDS), st.integers(0, 10_000).map(lambda half: 2 * half + 1))
@example(((Plane("range", 1, "range"),), {"range": np.ones((1, 1), np.uint8)}, np.zeros(1, np.int32)), KINDS[0], 1023)
@example(((Plane("range", 1, "range"),), {"range": np.ones((1, 1), np.uint8)}, np.zeros(1, np.int32)), KINDS[2], 1023)
def test_a_step_keeps_its_bound_and_every_return(made, kind: PlaneKind, step: int) -> None:
    forms, planes, shift = made
    found = back(kind, forms, planes, shift, step)
    for form in forms:
        before, after = planes[form.name].astype(np.int64), found[form.name].astype(np.int64)
        if form.role == "attribute":
            np.testing.assert_array_equal(after, before)
            continue
        assert np.all(np.abs(after - before) <= step // 2)
        np.testing.assert_array_equal(after > 0, before > 0)
        assert after.max(initial=0) < 1 << form.bits


@settings(deadline=None)
@given(images(), st.integers(0, 200).map(lambda half: 2 * half + 1))
def test_all_kinds_decode_to_the_same(made, step: int) -> None:
    """A bound means the same with every codec."""
    forms, planes, shift = made
    first, *others = (back(kind, forms, planes, shift, step) for kind in KINDS)
    for other in others:
        for name, plane in first.items():
            np.testing.assert_array_equal(other[name], plane)


@settings(deadline=None, max_examples=examples(300))
@given(st.binary(max_size=120), st.integers(0, 24_576))
def test_bytes_of_a_stranger_are_decode_errors(data: bytes, columns: int) -> None:
    with contextlib.suppress(DecodeError):
        decode_plane_section(data, columns)


@settings(deadline=None)
@given(images(), st.sampled_from(KINDS), st.integers(0, 2**32))
def test_damaged_bytes_are_decode_errors(made, kind: PlaneKind, seed: int) -> None:
    forms, planes, shift = made
    data, rng = encode_plane_section(kind, forms, planes, shift, 1), random.Random(seed)
    for _ in range(10):
        with contextlib.suppress(DecodeError):
            decode_plane_section(mutated(data, rng), planes["range"].shape[1])


@settings(deadline=None)
@given(images(), st.sampled_from(KINDS), st.integers(1, 256), st.integers(0, 2**32))
def test_planes_of_few_values_come_back_where_there_is_a_return(made, kind: PlaneKind, most: int, seed: int) -> None:
    forms, planes, shift = made
    rng, planes = np.random.default_rng(seed), dict(planes)
    tables: dict[str, Unsigned] = {}
    for form in forms:
        if form.role == "attribute" and rng.random() < 0.8:
            tables[form.name] = np.unique(rng.integers(0, 1 << form.bits, most)).astype(form.dtype)
            chosen = rng.choice(tables[form.name], planes[form.name].shape)
            planes[form.name] = np.where(planes[form.of] > 0, chosen, 0).astype(form.dtype)
    data = encode_plane_section(kind, forms, planes, shift, 1, tables, reduced=bool(seed % 2))
    head, found = read_head(data), decode_plane_section(data, planes["range"].shape[1])
    assert (head.reduced, head.tables.keys()) == (bool(seed % 2), tables.keys())
    assert not (head.exact and (tables or head.reduced))
    for form in forms:
        np.testing.assert_array_equal(found[form.name], planes[form.name])
    damage = random.Random(seed)
    for _ in range(5):
        with contextlib.suppress(DecodeError):
            decode_plane_section(mutated(data, damage), planes["range"].shape[1])


def head_bytes(forms: bytes, count: int, kind: int = 0, step: int = 1) -> bytes:
    return bytes([kind, 0, step, count]) + forms + b"\0"


def form_bytes(role: int = 0, bits: int = 16, of: int = 0, name: bytes = b"range") -> bytes:
    return bytes([role, bits, of, len(name)]) + name


def with_tables(tables: bytes) -> bytes:
    """The head of two planes, the second an attribute of 8 bits, in one row, with these tables."""
    return head_bytes(form_bytes() + form_bytes(2, 8, 0, b"intensity"), 2, kind=0x80) + tables


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (head_bytes(form_bytes(), 1, kind=4), "unknown kind 4"),
        (with_tables(b"\1\1\5\0\2"), "table 2 of 1"),
        (with_tables(b"\1\1\5\1\0"), "table 1 of 1, or not an attribute"),
        (with_tables(b"\1\2\5\0\0\1"), "do not ascend"),
        (with_tables(b"\1\1\x80\2\0\1"), "but its table holds 256"),
        (with_tables(b"\0"), "below 1"),
        (head_bytes(form_bytes(), 1, step=2), "not an odd number"),
        (head_bytes(form_bytes(role=3), 1), "unknown role 3"),
        (head_bytes(form_bytes(bits=21), 1), "21 bits"),
        (head_bytes(form_bytes(bits=0), 1), "0 bits"),
        (head_bytes(form_bytes(of=1), 1), "belongs to plane 1"),
        (head_bytes(form_bytes(name=b"signal"), 1), "first is not the ranges"),
        (head_bytes(form_bytes(role=1), 1), "first is not the ranges"),
        (head_bytes(form_bytes() + form_bytes(), 2), "occur twice"),
        (head_bytes(form_bytes() + form_bytes(2, 8, 1, b"i"), 2), "which is not one of ranges"),
        (head_bytes(form_bytes(name=b"ran/e"), 1), "letters, digits and underscores"),
        (head_bytes(form_bytes(name=b"\xe4"), 1), "letters, digits and underscores"),
    ],
)
def test_a_head_that_makes_no_sense_is_refused_by_its_reason(data: bytes, why: str) -> None:
    with pytest.raises(SectionError, match=why):
        read_head(data)


def test_images_beyond_the_limits_are_refused_before_they_take_memory() -> None:
    forms = (RANGE, *(Plane(f"p{k}", 8, "attribute") for k in range(11)))
    plain = {form.name: np.zeros((128, 1), form.dtype) for form in forms}
    data = encode_plane_section(PlaneKind.ZSTD, forms, plain, np.zeros(128, np.int32), 1)
    with pytest.raises(SectionError, match="5242880 numbers"):
        decode_plane_section(data, 24_576)
    with pytest.raises(SectionError, match="13 planes"):
        encode_plane_section(
            PlaneKind.PLAIN,
            (*forms, Plane("more", 8, "attribute")),
            {**plain, "more": plain["p1"]},
            np.zeros(128, np.int32),
            1,
        )


def test_a_value_of_more_bits_than_its_plane_is_damage() -> None:
    data = encode_plane_section(
        PlaneKind.PLAIN, (RANGE,), {"range": np.full((1, 1), 65_535, np.uint16)}, np.zeros(1, np.int32), 1
    )
    narrow = data.replace(bytes([0, 16, 0, 5]) + b"range", bytes([0, 15, 0, 5]) + b"range")
    with pytest.raises(SectionError, match="more than 15 bits"):
        decode_plane_section(narrow, 1)
