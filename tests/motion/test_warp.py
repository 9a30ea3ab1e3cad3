"""Expected ranges: both sides of a stream must find the same ones, and they must be those of the scene."""

from __future__ import annotations

import hashlib

import numpy as np
import numpy.typing as npt
import pytest

from lidarcodec.assembly import Assembler
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.motion.motion import MAX_CAYLEY, MAX_SHIFT, STILL, Motion
from lidarcodec.motion.warp import RangeHistory, beam_rows
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, SensorModel
from lidarcodec.sensors import find_calibration
from tests.packets import read_plain_pcap
from tests.reference.warp import ReferenceHistory

AZIMUTHS = np.tile((np.arange(2150) * 36000 // 2150).astype(np.uint16), (2, 1))
HEIGHT_M = 1.73


def sensor() -> SensorModel:
    """An HDL-64E with rotation corrections, offsets and distance corrections of its own for every laser."""
    laser = np.arange(64)
    return SensorModel(
        "HDL-64E",
        Calibration.from_values(
            {
                "vert_correction_rad": np.concatenate([np.linspace(0.03, -0.14, 32), np.linspace(-0.15, -0.43, 32)]),
                "rot_correction_rad": (laser * 7 % 11 - 5) * 0.02,
                "dist_correction_m": 0.9 + (laser * 5 % 13) * 0.02,
                "vert_offset_m": np.where(laser < 32, 0.2, 0.12),
                "horiz_offset_m": np.where(laser % 2, 0.026, -0.026),
            }
        ),
    )


def scene(
    model: SensorModel, azimuth: npt.NDArray[np.uint16], ahead_m: float, yaw: float = 0.0
) -> npt.NDArray[np.uint16]:
    """(64, W), what a sensor measures between a road and the four walls of a yard of 30 m by 16 m.

    ahead_m: how far it stands before the middle; yaw: turned to the left by so much
    """
    lasers = model.laser_of_ring
    get = {name: model.calibration[name][lasers][:, None] for name in CALIBRATION_FIELDS}
    half = (lasers >= 32).astype(int)
    beta = np.radians(azimuth[half] / 100.0) - get["rot_correction_rad"] - yaw
    v, vo, ho = get["vert_correction_rad"], get["vert_offset_m"], get["horiz_offset_m"]
    origin = np.stack([-vo * np.sin(v) * np.cos(beta) + ho * np.sin(beta) + ahead_m,
                       ho * np.cos(beta) + vo * np.sin(v) * np.sin(beta), vo * np.cos(v) + 0 * beta])  # fmt: skip
    along = np.stack([np.cos(v) * np.cos(beta), -np.cos(v) * np.sin(beta), np.sin(v) + 0 * beta])
    with np.errstate(divide="ignore"):
        walls = [np.where(along[i] * side > 1e-9, (side * at - origin[i]) / along[i], np.inf)
                 for i, at in ((0, 15.0), (1, 8.0)) for side in (1, -1)]  # fmt: skip
        road = np.where(along[2] < -1e-9, (-HEIGHT_M - origin[2]) / along[2], np.inf)
    length = np.minimum.reduce([*walls, road]) - get["dist_correction_m"]
    ranges: npt.NDArray[np.uint16] = np.clip(np.rint(length / 0.002), 1, 65535).astype(np.uint16)
    return ranges


def moved(ahead_m: float, yaw: float = 0.0) -> Motion:
    """The motion of a sensor that drove ahead and turned left."""
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]
    matrix[:2, 3] = matrix[:2, :2] @ [-ahead_m, 0.0]
    found = Motion.nearest(matrix)
    assert found is not None
    return found


def everywhere(azimuth: npt.NDArray[np.uint16]) -> npt.NDArray[np.bool_]:
    return np.ones(azimuth.shape, np.bool_)


def expect(
    before: npt.NDArray[np.uint16], motion: Motion, azimuth: npt.NDArray[np.uint16], model: SensorModel
) -> npt.NDArray[np.uint16]:
    history = RangeHistory()
    history.remember(before, AZIMUTHS, everywhere(AZIMUTHS), model)
    return history.expected(motion, azimuth, everywhere(azimuth), model)


@pytest.mark.parametrize(("ahead_m", "yaw"), [(0.0, 0.0), (1.2, 0.0), (0.4, 0.03), (-0.7, -0.02)])
def test_road_and_walls_are_expected_where_they_are(ahead_m: float, yaw: float) -> None:
    model = sensor()
    azimuth = (AZIMUTHS + 5) % 36000  # between the firings of the turn before
    expected = expect(scene(model, AZIMUTHS, 0.0), moved(ahead_m, yaw), azimuth, model)
    truth = scene(model, azimuth, ahead_m, yaw)
    off = np.abs(expected.astype(int) - truth)[expected > 0]
    assert (expected > 0).mean() > 0.95  # nearer than the lowest ring saw, nothing is known
    assert np.median(off) <= 1
    assert (off <= 10).mean() > 0.96


def test_without_motion_each_return_is_expected_again() -> None:
    model = sensor()
    before = scene(model, AZIMUTHS, 0.0)
    off = np.abs(expect(before, STILL, AZIMUTHS, model).astype(int) - before)
    assert np.median(off) <= 1
    assert (off <= 4).mean() > 0.9


def test_frames_may_end_anywhere() -> None:
    """Slabs see what a whole frame sees: the history is by direction, not by frame."""
    model = sensor()
    before = scene(model, AZIMUTHS, 0.0)
    whole, slabs = RangeHistory(), RangeHistory()
    whole.remember(before, AZIMUTHS, everywhere(AZIMUTHS), model)
    parts = [slice(at, at + 174) for at in range(0, 2150, 174)]
    for part in parts:
        slabs.remember(before[:, part], AZIMUTHS[:, part], everywhere(AZIMUTHS[:, part]), model)
    motion = moved(0.5)
    expected = whole.expected(motion, AZIMUTHS, everywhere(AZIMUTHS), model)
    assert np.array_equal(expected, slabs.expected(motion, AZIMUTHS, everywhere(AZIMUTHS), model))
    for part in parts:
        one = slabs.expected(motion, AZIMUTHS[:, part], everywhere(AZIMUTHS[:, part]), model)
        agree = one == expected[:, part]
        assert agree.mean() > 0.999


def test_what_was_swept_over_without_firing_is_forgotten() -> None:
    model = sensor()
    history = RangeHistory()
    history.remember(scene(model, AZIMUTHS, 0.0), AZIMUTHS, everywhere(AZIMUTHS), model)
    gap = (AZIMUTHS[0] < 9000) | (AZIMUTHS[0] > 12000)
    history.remember(scene(model, AZIMUTHS[:, gap], 0.0), AZIMUTHS[:, gap], everywhere(AZIMUTHS[:, gap]), model)
    known = history.expected(STILL, AZIMUTHS, everywhere(AZIMUTHS), model) > 0
    assert known[:, gap].mean() > 0.99
    assert known[:, (AZIMUTHS[0] > 10000) & (AZIMUTHS[0] < 11000)].mean() < 0.01
    history.forget()
    assert not history.expected(STILL, AZIMUTHS, everywhere(AZIMUTHS), model).any()


def small_case(seed: int) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint16], npt.NDArray[np.bool_], Motion]:
    """A few columns of a scene with holes and nonsense, and any motion."""
    rng = np.random.default_rng(seed)
    swept = np.cumsum(rng.choice([9, 18, 18, 18, 120], (2, 24)), axis=1) + rng.integers(0, 36000)
    azimuth = (swept % 36000).astype(np.uint16)
    ranges = scene(sensor(), azimuth, 0.0)
    ranges[rng.random(ranges.shape) < 0.1] = 0
    wild = rng.random(ranges.shape) < 0.1
    ranges[wild] = rng.integers(0, 65536, wild.sum())
    size = rng.choice([0, 200, MAX_CAYLEY])
    far = min(50 * size, MAX_SHIFT)
    turn, shift = rng.integers(-size, size + 1, 3), rng.integers(-far, far + 1, 3)
    return ranges, azimuth, rng.random((2, 24)) < 0.9, Motion(tuple(turn.tolist()), tuple(shift.tolist()))


@pytest.mark.parametrize("seed", range(6))
def test_native_and_reference_expect_the_same(seed: int) -> None:
    """Another implementation that follows the document gets the same numbers, or it cannot decode."""
    model = sensor()
    ranges, azimuth, fired, motion = small_case(seed)
    native, reference = RangeHistory(), ReferenceHistory()
    for shift in (0, 24):  # a second time a little further on: the history is overwritten in part
        shifted = ((azimuth.astype(int) + shift) % 36000).astype(np.uint16)
        native.remember(ranges, shifted, fired, model)
        reference.remember(ranges, shifted, fired, beam_rows(model))
    expected = native.expected(motion, azimuth, fired, model)
    assert np.array_equal(expected, reference.expected(motion.numbers, azimuth, fired, beam_rows(model)))
    assert expected.any() or seed


@pytest.mark.parametrize("first", [35_940, 8_970])
def test_a_part_of_a_turn_expects_what_the_reference_does(first: int) -> None:
    """Only what a part can see is computed. Who left out too much would decode other ranges, without an error."""
    model = sensor()
    native, reference = RangeHistory(), ReferenceHistory()
    around = AZIMUTHS[:, ::6]
    ranges = scene(model, around, 0.0)
    native.remember(ranges, around, everywhere(around), model)
    reference.remember(ranges, around, everywhere(around), beam_rows(model))
    part = ((first + np.arange(0, 360, 18)) % 36000 + np.zeros((2, 1), int)).astype(np.uint16)
    motion, fired = moved(1.0, 0.05), everywhere(part)
    expected = native.expected(motion, part, fired, model)
    assert np.array_equal(expected, reference.expected(motion.numbers, part, fired, beam_rows(model)))
    assert (expected > 0).mean() > 0.3


def test_every_build_expects_the_same() -> None:
    """Made with gcc 12 -O3; other compilers, levels and machines must give it too, or streams cannot be shared."""
    digest, model = hashlib.sha256(), sensor()
    row, column = np.arange(64)[:, None], np.arange(2150)
    for seed, motion in enumerate(
        [STILL, Motion((300, -200, 90_000), (-19_000, 500, -90)), Motion((MAX_CAYLEY, 5, 9))]
    ):
        rough = (row * 7919 + column * (104_729 + seed)) % 97  # whole numbers: no library's sine
        before = np.where(rough == 0, 0, 12_000 - 150 * row + column % 700 * 3 + rough % 9).astype(np.uint16)
        digest.update(expect(before, motion, (AZIMUTHS + 7) % 36000, model).astype("<u2").tobytes())
    assert digest.hexdigest()[:32] == "4134452e70db5057b8a043151f6c5158"


@pytest.mark.parametrize("columns", [0, 1, 2])
def test_almost_nothing(columns: int) -> None:
    model = sensor()
    azimuth = AZIMUTHS[:, :columns]
    history = RangeHistory()
    assert not history.expected(moved(1.0), azimuth, everywhere(azimuth), model).any()
    history.remember(scene(model, azimuth, 0.0), azimuth, everywhere(azimuth), model)
    assert history.expected(STILL, azimuth, everywhere(azimuth), model).shape == (64, columns)
    assert not history.expected(STILL, azimuth, ~everywhere(azimuth), model).any()


def test_any_motion_and_calibration_is_harmless() -> None:
    rng = np.random.default_rng(3)
    fields = ["vert_correction_rad", "rot_correction_rad", "dist_correction_m", "vert_offset_m", "horiz_offset_m"]
    for size in (0.1, 3.0, 20.0):
        model = SensorModel("HDL-64E", Calibration.from_values({name: rng.uniform(-size, size, 64) for name in fields}))
        ranges = rng.integers(0, 65536, (64, 2150)).astype(np.uint16)
        history = RangeHistory()
        history.remember(ranges, AZIMUTHS, everywhere(AZIMUTHS), model)
        for part in (-1, 1):
            motion = Motion((part * MAX_CAYLEY,) * 3, (part * MAX_SHIFT,) * 3)
            history.expected(motion, AZIMUTHS, everywhere(AZIMUTHS), model)
        extremes = rng.choice(np.array([-(2**31), 2**31 - 1], np.int32), 12)
        history.native.expected(extremes, AZIMUTHS, everywhere(AZIMUTHS).view(np.uint8), beam_rows(model))


def test_a_sensor_whose_blocks_fire_apart(data_file) -> None:
    """The real S3 sends three upper blocks for a lower one, each at an azimuth of its own."""
    packets = read_plain_pcap(data_file("hdl64e_s3_atwall.pcap"))
    model = find_calibration(data_file("hdl64e_s3_atwall.pcap"), None, [packets[0].payload])
    assembler = Assembler(model, "packets:29")
    frames = [frame for packet in packets if (frame := assembler.push(packet)) is not None]
    history = RangeHistory()
    off: list[npt.NDArray[np.int64]] = []
    for frame in frames:
        if off or frame.index >= 9:  # a turn is 263 packets: the last slabs see what the first saw
            expected = history.expected(STILL, frame.azimuth, frame.fired, model)
            both = (expected > 0) & (frame.range > 0)
            off.append(np.abs(expected.astype(np.int64) - frame.range)[both])
        history.remember(frame.range_u16, frame.azimuth, frame.fired, model)
    assert sum(map(len, off)) > 3000
    assert np.median(np.concatenate(off)) < 25


def test_bad_input_is_refused() -> None:
    model, history = sensor(), RangeHistory()
    azimuth = AZIMUTHS[:, :5]
    with pytest.raises(SectionError, match="36000 is beyond a turn: 35999 is the largest"):
        history.expected(STILL, np.full((2, 3), 36000, np.uint16), np.ones((2, 3), bool), model)
    with pytest.raises(SectionError, match="ranges are"):
        history.remember(np.zeros((64, 4), np.uint16), azimuth, everywhere(azimuth), model)
    with pytest.raises(SectionError, match="azimuth is"):
        history.expected(STILL, azimuth.astype(np.int32), everywhere(azimuth), model)  # type: ignore[arg-type]
    with pytest.raises(SectionError, match="the limit is"):
        history.expected(STILL, np.zeros((2, 30000), np.uint16), np.ones((2, 30000), bool), model)


def frame_of(
    model: SensorModel, ranges: npt.NDArray[np.uint16], azimuth: npt.NDArray[np.uint16], **more: object
) -> Frame:
    """A frame of these ranges."""
    fields = {"index": 0, "stamp_ns": 0, **more}
    return Frame(range=ranges, intensity=np.zeros(ranges.shape, np.uint8), azimuth=azimuth,
                 fired=everywhere(azimuth), sensor=model, **fields)  # type: ignore[arg-type]  # fmt: skip
