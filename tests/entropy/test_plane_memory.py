"""Planes of frames that follow each other come back, in fewer bytes, and damage does not outlive a frame."""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt
import pytest

from lidarcodec.entropy import plane_coder
from lidarcodec.entropy.plane_coder import PlaneMemory, Unsigned, encode_planes
from lidarcodec.errors import DecodeError, SectionError, SettingsError
from tests.entropy.driven import DRIVEN, driven
from tests.entropy.test_plane_coder import DUAL, FRAMES, Form, every_way, noise, rounded, scene
from tests.reference import planes as reference
from tests.sweeps import sampled

Planes = dict[str, Unsigned]


def runs_of(columns: int, before: int, rng: np.random.Generator) -> npt.NDArray[np.uint32]:
    """Runs that cut a frame in up to three."""
    cuts = sorted({0, *rng.integers(0, columns, 2).tolist()}) if columns else []
    counts = np.diff([*cuts, columns])
    return np.stack((counts, rng.integers(0, before, len(counts))), axis=1).astype(np.uint32)


def again(planes: Planes, rng: np.random.Generator) -> Planes:
    """The same scene a turn later: a little noise, and a few columns seen anew."""
    found = {}
    for name, image in planes.items():
        moved = image + (rng.random(image.shape) < 0.2) * (image > 0)
        found[name] = np.minimum(moved, int(image.max(initial=0))).astype(np.uint32)
    return found


@pytest.mark.parametrize(("seed", "step"), sampled(product(range(3), [1, 7]), [(2, 1)]))
def test_a_decoder_written_from_the_page_gives_the_same_frames(step: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    forms, planes = every_way(rng) if seed < 2 else (DUAL, noise(DUAL, (4, 21), rng))
    ordered = plane_coder.in_order(forms)
    table = [reference.Form(*map(int, row)) for row in plane_coder.form_table(ordered)]
    there, back, by_page = PlaneMemory(), PlaneMemory(), reference.Memory()
    before = 0
    for number in range(4):
        if number == 2:  # a frame of other columns
            planes = {name: image[:, 3:].copy() for name, image in planes.items()}
        rows, columns = planes["range"].shape
        shift = rng.integers(-50, 50, rows).astype(np.int32)
        runs = runs_of(columns, before, rng) if before and number != 3 else None
        data = there.encode(forms, planes, shift, step, runs)
        found = back.decode(data, columns, forms, shift, step)
        expected = reference.decode_next(by_page, data, (rows, columns), table, shift.tolist(), step)
        for form, image in zip(ordered, expected, strict=True):
            wanted = planes[form.name] if form.role == "attribute" else rounded(planes[form.name], step, form.bits)
            np.testing.assert_array_equal(found[form.name], wanted)
            np.testing.assert_array_equal(image, wanted)
        before, planes = columns, again(planes, rng)


@pytest.mark.parametrize("forms", FRAMES)
def test_a_scene_that_stands_still_needs_fewer_bytes_than_frames_alone(forms: tuple[Form, ...]) -> None:
    rng, shift, memory = np.random.default_rng(4), np.zeros(16, np.int32), PlaneMemory()
    planes = scene(forms, (16, 200), rng)
    sizes = []
    for number in range(4):
        runs = np.array([[200, 0]], np.uint32) if number else None
        sizes.append(len(memory.encode(forms, planes, shift, 1, runs)))
        planes = again(planes, rng)
    assert sizes[-1] < 0.8 * len(encode_planes(forms, planes, shift))


def test_other_planes_or_rows_begin_anew_on_both_sides() -> None:
    rng, there, back = np.random.default_rng(5), PlaneMemory(), PlaneMemory()
    runs = np.array([[30, 0]], np.uint32)
    for forms, rows in ((DUAL, 6), (DUAL[:3], 6), (DUAL[:3], 9), (DUAL, 6), (DUAL, 6)):
        planes, shift = scene(forms, (rows, 30), rng), np.zeros(rows, np.int32)
        found = back.decode(there.encode(forms, planes, shift, 1, runs), 30, forms, shift)
        for form in forms:
            np.testing.assert_array_equal(found[form.name], planes[form.name])


@pytest.mark.parametrize("seed", range(60))
def test_damaged_frames_are_refused_or_decode_to_something(seed: int) -> None:
    rng, there, back = np.random.default_rng(seed), PlaneMemory(), PlaneMemory()
    forms, shift, columns = FRAMES[seed % 3], np.zeros(5, np.int32), 21
    planes = scene(forms, (5, columns), rng)
    first = there.encode(forms, planes, shift)
    second = bytearray(there.encode(forms, again(planes, rng), shift, 1, runs_of(columns, columns, rng)))
    back.decode(first, columns, forms, shift)
    for _ in range(1 + seed % 3):
        second[rng.integers(0, len(second) if seed % 2 else 12)] ^= 1 << rng.integers(0, 8)
    damaged = bytes(second[: rng.integers(0, len(second))] if seed % 5 == 0 else second)
    try:
        found = back.decode(damaged, columns, forms, shift)
    except DecodeError:
        with pytest.raises(SectionError, match="runs of columns"):  # it forgot the first frame
            back.decode(there.encode(forms, planes, shift, 1, runs_of(columns, columns, rng)), columns, forms, shift)
        back.decode(first, columns, forms, shift)
    else:
        assert all(int(found[form.name].max(initial=0)) < 1 << form.bits for form in forms)


@pytest.mark.parametrize("runs", [[[20, 0]], [[22, 0]], [[21, 21]], [[0, 0], [21, 0]], [[21, 0], [1, 0]]])
def test_runs_that_do_not_fit_are_refused(runs: list[list[int]]) -> None:
    rng, memory, shift = np.random.default_rng(1), PlaneMemory(), np.zeros(5, np.int32)
    planes = scene(DUAL, (5, 21), rng)
    memory.encode(DUAL, planes, shift)
    with pytest.raises(SettingsError, match="runs of columns"):
        memory.encode(DUAL, planes, shift, 1, np.array(runs, np.uint32))


@pytest.mark.sweep
def test_a_sensor_that_drives_sees_the_frame_before_from_its_place() -> None:
    step = 3
    ordered = plane_coder.in_order(DRIVEN)
    table = [reference.Form(*map(int, row)) for row in plane_coder.form_table(ordered)]
    there, still, back, by_page = PlaneMemory(), PlaneMemory(), PlaneMemory(), reference.Memory()
    rows, columns = 8, 120
    shift, sizes = np.zeros(rows, np.int32), []
    for number in range(3):
        planes, view = driven(number)
        runs = np.array([[columns, 0]], np.uint32) if number else None
        data = there.encode(DRIVEN, planes, shift, step, runs, view)
        sizes.append((len(data), len(still.encode(DRIVEN, planes, shift, step, runs))))
        found = back.decode(data, columns, DRIVEN, shift, step)
        expected = reference.decode_next(by_page, data, (rows, columns), table, shift.tolist(), step)
        assert (by_page.view.motion is not None) == (number > 0)
        for form, image in zip(ordered, expected, strict=True):
            wanted = planes[form.name] if form.role == "attribute" else rounded(planes[form.name], step, form.bits)
            np.testing.assert_array_equal(found[form.name], wanted)
            np.testing.assert_array_equal(image, wanted)
    assert sizes[2][0] < 0.95 * sizes[2][1]
