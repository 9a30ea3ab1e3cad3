"""Planes come back as they were, and damaged bytes are refused."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.entropy import plane_coder
from lidarcodec.entropy.plane_coder import PlaneForm, Unsigned, decode_planes, encode_planes
from lidarcodec.errors import DecodeError, SectionError, SettingsError, TruncatedError
from tests.entropy.driven import Form
from tests.reference import planes as reference
from tests.sweeps import examples, paired

RANGE, SECOND = Form("range", 16, "range"), Form("range2", 16, "second range")
SIMPLE = (RANGE, Form("intensity", 8))
DUAL = (
    RANGE,
    SECOND,
    Form("signal", 16),
    Form("intensity", 8),
    Form("intensity2", 8, of="range2"),
    Form("near_ir", 16),
    Form("signal2", 16, of="range2"),
)
WIDE = (Form("range", 20, "range"), Form("flags", 1), Form("odd", 20))
FRAMES = (SIMPLE, DUAL, WIDE)
EXTREME_SHAPES = [(1, 1), (1, 4096), (128, 1), (128, 3), (16, 4096), (3, 0)]


def noise(forms: tuple[Form, ...], shape: tuple[int, int], rng: np.random.Generator) -> dict[str, Unsigned]:
    """Any values at all."""
    return {form.name: rng.integers(0, 1 << form.bits, shape, np.uint32) for form in forms}


def scene(forms: tuple[Form, ...], shape: tuple[int, int], rng: np.random.Generator) -> dict[str, Unsigned]:
    """A floor with boxes, holes and a second return here and there; attributes that follow from the ranges."""
    rows, columns = np.indices(shape)
    far = 400 + 3000 * (columns // 37 % 3) + 90 * rows + rng.integers(0, 4, shape)
    has = rng.random(shape) > 0.1
    first = np.where(has, far, 0)
    second = np.where(rng.random(shape) > 0.04, first, first + 700 * has)
    found = {}
    for form in forms:
        ranges = second if form.name.endswith("2") else first
        values = ranges if form.role != "attribute" else ranges // 16 + rng.integers(0, 3, shape)
        found[form.name] = values.astype(np.uint32) & np.uint32((1 << form.bits) - 1)
    return found


def constant(value: int, forms: tuple[Form, ...], shape: tuple[int, int]) -> dict[str, Unsigned]:
    """One value everywhere, as far as the bits go."""
    return {form.name: np.full(shape, min(value, (1 << form.bits) - 1), np.uint32) for form in forms}


def rounded(ranges: Unsigned, step: int, bits: int) -> npt.NDArray[np.int64]:
    """What docs/wire-format.md, "Range steps", makes of ranges."""
    half = (step - 1) // 2
    index = (ranges.astype(np.int64) + half) // step
    back = np.minimum(np.where(index == 0, (half + 1) // 2, index * step), (1 << bits) - 1)
    return np.where(ranges == 0, 0, back) if step > 1 else ranges.astype(np.int64)


def check(
    planes: dict[str, Unsigned],
    forms: tuple[Form, ...],
    shift: npt.NDArray[np.int32],
    step: int = 1,
    *,
    quick: bool = False,
) -> bytes:
    columns = planes["range"].shape[1]
    data = encode_planes(forms, planes, shift, step, quick=quick)
    back = decode_planes(data, columns, forms, shift, step)
    assert list(back) == [form.name for form in forms]
    for form in forms:
        wanted = planes[form.name] if form.role == "attribute" else rounded(planes[form.name], step, form.bits)
        np.testing.assert_array_equal(back[form.name], wanted)
        assert back[form.name].dtype == (np.uint8 if form.bits <= 8 else np.uint16 if form.bits <= 16 else np.uint32)
    return data


@given(
    st.sampled_from(FRAMES),
    st.integers(1, 12),
    st.integers(0, 40),
    st.sampled_from((noise, scene)),
    st.sampled_from((1, 1, 3, 11, 501)),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=examples(150), deadline=None)
def test_any_planes_come_back(forms, rows, columns, kind, step, seed) -> None:
    rng = np.random.default_rng(seed)
    shift = rng.integers(-(2**31), 2**31, rows, np.int32) if seed % 2 else np.zeros(rows, np.int32)
    check(kind(forms, (rows, columns), rng), forms, shift, step, quick=seed % 3 == 0)


@pytest.mark.parametrize(("forms", "shape", "value"), paired(FRAMES, EXTREME_SHAPES, [0, 1, 255, 2**20]))
def test_extreme_shapes_and_values_come_back(forms, shape, value) -> None:
    rng = np.random.default_rng(7)
    shift = rng.integers(-40, 40, shape[0], np.int32)
    check(constant(value, forms, shape), forms, shift)
    planes = noise(forms, shape, rng)
    planes["range"][:] = min(value, (1 << forms[0].bits) - 1)
    check(planes, forms, shift)
    check(planes, forms, shift, 65535, quick=True)


def test_no_range_is_further_than_half_a_step_from_what_it_was() -> None:
    every = np.arange(2**16, dtype=np.uint32).reshape(16, 4096)
    for step in (3, 15, 255):
        data = encode_planes((RANGE,), {"range": every}, np.zeros(16, np.int32), step)
        back = decode_planes(data, 4096, (RANGE,), np.zeros(16, np.int32), step)["range"]
        assert np.abs(back.astype(np.int64) - every).max() <= (step - 1) // 2
        np.testing.assert_array_equal(back == 0, every == 0)


def test_ranges_that_are_aligned_take_fewer_bytes() -> None:
    rng = np.random.default_rng(1)
    shift = np.where(np.arange(32) % 2, 20, -20).astype(np.int32)
    looks = scene(SIMPLE, (32, 512), rng)
    sent = {name: np.stack([np.roll(row, -by) for row, by in zip(a, shift, strict=True)]) for name, a in looks.items()}
    assert len(check(sent, SIMPLE, shift)) < 0.97 * len(check(sent, SIMPLE, np.zeros(32, np.int32)))


@pytest.mark.parametrize("kind", [noise, scene])
@pytest.mark.parametrize("quick", [False, True])
def test_planes_that_are_cut_or_longer_are_refused(kind, quick) -> None:
    shift = np.zeros(4, np.int32)
    data = check(kind(DUAL, (4, 20), np.random.default_rng(3)), DUAL, shift, quick=quick)
    for end in range(len(data)):
        with pytest.raises((SectionError, TruncatedError)):
            decode_planes(data[:end], 20, DUAL, shift)
    with pytest.raises(SectionError):
        decode_planes(data + b"\0", 20, DUAL, shift)


@given(st.binary(max_size=400), st.sampled_from(FRAMES), st.integers(0, 30), st.integers(0, 2**32 - 1))
@settings(max_examples=examples(150), deadline=None)
def test_damaged_planes_are_refused_or_decode_to_something(tail, forms, columns, seed) -> None:
    rng = np.random.default_rng(seed)
    shift = rng.integers(-9, 9, 5, np.int32)
    data = bytearray(encode_planes(forms, scene(forms, (5, columns), rng), shift, quick=seed % 2 == 1))
    for _ in range(1 + seed % 4):
        data[rng.integers(0, len(data))] ^= 1 << rng.integers(0, 8)
    for bad in (bytes(data), b"\1" + tail, tail):
        try:
            back = decode_planes(bad, columns, forms, shift)
        except DecodeError:
            continue
        for form in forms:
            assert back[form.name].shape == (5, columns)
            assert int(back[form.name].max(initial=0)) < 1 << form.bits


@pytest.mark.parametrize(
    ("forms", "shift", "step", "why"),
    [
        (SIMPLE, np.zeros(3, np.int32), 1, "one shape"),
        (SIMPLE, np.zeros(4, np.int32), 2, "odd"),
        ((Form("range", 21, "range"),), np.zeros(4, np.int32), 1, "20 bits"),
        ((Form("range", 3, "range"),), np.zeros(4, np.int32), 1, "more bits"),
        ((), np.zeros(4, np.int32), 1, "1 to 32"),
    ],
)
def test_what_does_not_fit_together_is_refused(
    forms: tuple[PlaneForm, ...], shift: npt.NDArray[np.int32], step: int, why: str
) -> None:
    planes: dict[str, Unsigned] = {"range": np.full((4, 5), 9, np.uint16), "intensity": np.zeros((4, 5), np.uint8)}
    with pytest.raises(SettingsError, match=why):
        encode_planes(forms, planes, shift, step)


def test_planes_of_other_numbers_are_refused() -> None:
    """They were cut to 32 bits without a word."""
    planes = {"range": np.full((4, 5), 2**32 + 9, np.uint64), "intensity": np.zeros((4, 5), np.uint8)}
    with pytest.raises(SettingsError, match="uint8, uint16 or uint32"):
        encode_planes(SIMPLE, planes, np.zeros(4, np.int32))


def every_way(rng: np.random.Generator) -> tuple[tuple[Form, ...], dict[str, Unsigned]]:
    """Planes that are coded in every way: a constant, a sparse one, symbols, one with a unit, one with a mate."""
    forms = (*DUAL, Form("flags", 8), Form("none", 16), Form("steps", 16))
    planes = scene(DUAL, (5, 37), rng)
    brightness = np.repeat(rng.integers(20, 200, (5, 10)), 4, axis=1)[:, :37]
    planes["intensity"] = (brightness + rng.integers(0, 2, (5, 37))).astype(np.uint32)
    planes["intensity2"] = planes["intensity"].copy()
    planes["signal"] = planes["intensity"] * np.uint32(31) + rng.integers(0, 9, (5, 37)).astype(np.uint32)
    planes["flags"] = (rng.random((5, 37)) < 0.03).astype(np.uint32) * np.uint32(200)
    planes["none"] = np.full((5, 37), 77, np.uint32)
    planes["steps"] = rng.integers(0, 100, (5, 37)).astype(np.uint32) * np.uint32(48)
    return forms, planes


@pytest.mark.parametrize(
    ("seed", "step", "quick"),
    paired(range(4), [1, 7], [False, True]),
)
def test_a_decoder_written_from_the_page_gives_the_same_planes(quick, step, seed) -> None:
    rng = np.random.default_rng(seed)
    forms, planes = every_way(rng) if seed < 2 else (FRAMES[seed - 1], noise(FRAMES[seed - 1], (4, 21), rng))
    shape = planes["range"].shape
    shift = rng.integers(-50, 50, shape[0]).astype(np.int32)
    data = check(planes, forms, shift, step, quick=quick)
    ordered = plane_coder.in_order(forms)
    table = [reference.Form(*map(int, row)) for row in plane_coder.form_table(ordered)]
    if seed < 2:
        heads, _ = reference.read_heads(data, table)
        assert {head.way for head in heads} == {0, 1, 2, 3}
        assert any(head.mate != 255 for head in heads)
        assert any(head.unit > 1 for head in heads)
    back = decode_planes(data, shape[1], forms, shift, step)
    decoded = reference.decode(data, (shape[0], shape[1]), table, shift.tolist(), step)
    for form, image in zip(ordered, decoded, strict=True):
        np.testing.assert_array_equal(back[form.name], image)
