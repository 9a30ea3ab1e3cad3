"""Motions: sent in whole numbers, found by the encoder from poses or from what the sensor saw."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
import pytest

from lidarcodec.errors import SectionError
from lidarcodec.message import Section, SectionType
from lidarcodec.motion.finder import MotionFinder
from lidarcodec.motion.motion import MAX_CAYLEY, STILL, Motion, encode_motion
from lidarcodec.motion.warp import RangeHistory, beam_rows
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from tests.contracts import frames
from tests.motion.test_warp import AZIMUTHS, frame_of, moved, scene, sensor

PERIOD_NS = 100_000_000


def test_a_section_is_six_numbers_of_three_bytes() -> None:
    assert encode_motion(STILL) == bytes(18)
    six = [b"\1\0\0", b"\xfe\xff\xff", b"\3\0\0", b"\xfc\xff\xff", b"\5\0\0", b"\xfa\xff\xff"]
    assert encode_motion(Motion((1, -2, 3), (-4, 5, -6))) == b"".join(six)


@pytest.mark.parametrize(
    "data", [b"", bytes(17), bytes(19), b"\xff\xff\x7f" + bytes(15), bytes(9) + b"\x01\xe2\x04" * 3]
)
def test_no_motion_beyond_the_limits_is_read(data: bytes) -> None:
    encoder = StreamEncoder(StreamSettings(codec="predictive", codec_settings={"motion": True}), stream_id=1)
    key, moved_on = (encoder.encode(frames.scene(4).with_(index=index))[0] for index in range(2))
    others = tuple(section for section in moved_on.sections if section.type != SectionType.MOTION)
    decoder = StreamDecoder()
    decoder.decode(key)
    with pytest.raises(SectionError, match="motion"):
        decoder.decode(replace(moved_on, sections=(*others, Section(SectionType.MOTION, data))))


def test_any_three_numbers_are_a_rotation() -> None:
    """A decoder need not check: points are never stretched."""
    rng = np.random.default_rng(5)
    for turn in [
        (0, 0, 0),
        (MAX_CAYLEY, MAX_CAYLEY, -MAX_CAYLEY),
        *rng.integers(-MAX_CAYLEY, MAX_CAYLEY, (20, 3)).tolist(),
    ]:
        rotation = Motion(tuple(turn)).matrix[:3, :3]
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 4e-9
        assert np.linalg.det(rotation) > 0


def test_a_transform_is_met_to_a_tenth_of_a_millimetre() -> None:
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]]
    matrix[:3, 3] = [1.23456, -0.5, 0.01]
    motion = Motion.nearest(matrix)
    assert motion is not None
    assert np.abs(motion.matrix - matrix)[:3, :3].max() < 2e-7
    assert np.abs(motion.matrix - matrix)[:3, 3].max() < 1e-4
    assert Motion.nearest(np.full((4, 4), np.nan)) is None
    matrix[0, 3] = 21.0
    assert Motion.nearest(matrix) is None


@pytest.mark.parametrize(("ahead_m", "yaw"), [(0.0, 0.0), (1.0, 0.0), (0.6, 0.03)])
def test_the_motion_is_found_from_what_was_seen(ahead_m: float, yaw: float) -> None:
    model = sensor()
    rng = np.random.default_rng(1)
    first, second = (
        np.clip(scene(model, AZIMUTHS, *at).astype(int) + rng.integers(-5, 6, (64, 2150)), 1, 65535).astype(np.uint16)
        for at in ((0.0, 0.0), (ahead_m, yaw))
    )
    history, finder = RangeHistory(), MotionFinder()
    assert finder.next(frame_of(model, first, AZIMUTHS), history).origin == "still"
    history.remember(first, AZIMUTHS, np.ones(AZIMUTHS.shape, bool), model)
    frame = frame_of(model, second, AZIMUTHS, index=1)
    found = finder.next(frame, history)
    assert found.origin == "found"
    assert np.abs(found.motion.matrix - moved(ahead_m, yaw).matrix)[:3, 3].max() < 0.02
    assert np.abs(found.motion.matrix - moved(ahead_m, yaw).matrix)[:3, :3].max() < 0.001
    again = MotionFinder()
    again.next(frame_of(model, first, AZIMUTHS), RangeHistory())
    assert again.next(frame, history) == found  # the same stream twice gives the same bytes


def test_slabs_go_on_with_the_motion_of_the_last_turn() -> None:
    model = sensor()
    history, finder = RangeHistory(), MotionFinder()
    origins, shifts, driven = [], [], [0.0, 0.5, 1.0, 1.5, 2.5, 3.5]
    for turn in range(6):
        for at in range(0, 2150, 215):
            part = np.ascontiguousarray(AZIMUTHS[:, at : at + 215])
            frame = frame_of(model, scene(model, part, driven[turn]), part, index=turn * 10 + at // 215)
            found = finder.next(frame, history)
            history.remember(frame.range_u16, frame.azimuth, frame.fired, model)
            origins.append(found.origin)
            shifts.append(found.motion.matrix[0, 3])
    assert set(origins[:10]) == {"still"}
    assert set(origins[20:]) == {"found", "kept"}
    assert origins[20:].count("found") == 8  # twice a turn
    assert np.abs(np.array(shifts[30:40]) + 0.5).max() < 0.05
    assert np.abs(np.array(shifts[-5:]) + 1.0).max() < 0.05  # half a turn late, another motion is known


def test_poses_give_the_motion_of_a_turn() -> None:
    """A frame of 348 packets is 0.97 of a turn, a slab a twelfth: both need the motion of a whole one."""
    model = sensor()
    for columns in (2088, 174):
        finder, ahead = MotionFinder(refine=False), np.eye(4)
        for index in range(3):
            at = np.arange(index * columns, (index + 1) * columns)
            azimuth = np.tile((at * 36000 // 2150 % 36000).astype(np.uint16), (2, 1))
            pose = ahead.copy()
            pose[0, 3] = 1.075 * columns / 2150 * index
            frame = frame_of(model, scene(model, azimuth, 0.0), azimuth, index=index, pose=pose,
                             stamp_ns=PERIOD_NS * columns // 2150 * index)  # fmt: skip
            found = finder.next(frame, RangeHistory())
        assert found.origin == "poses"
        assert abs(found.motion.matrix[0, 3] + 1.075) < 0.01


def test_a_lost_scene_keeps_the_motion_and_then_stands() -> None:
    model = sensor()
    rng = np.random.default_rng(2)
    history, finder = RangeHistory(), MotionFinder()
    for index in range(2):
        frame = frame_of(model, scene(model, AZIMUTHS, 0.5 * index), AZIMUTHS, index=index)
        found = finder.next(frame, history)
        history.remember(frame.range_u16, frame.azimuth, frame.fired, model)
    assert found.origin == "found"
    origins = []
    for index in range(2, 16):
        noise = rng.integers(1, 65536, (64, 2150)).astype(np.uint16)
        lost = finder.next(frame_of(model, noise, AZIMUTHS, index=index), history)
        origins.append(lost.origin)
        assert lost.motion == (found.motion if lost.origin == "kept" else STILL)
    assert origins[0] == "kept"
    assert origins[-1] == "still"


@pytest.mark.sweep
def test_a_stream_that_begins_at_speed_finds_its_motion_at_once(data_file) -> None:
    """Its first search begins at rest, a metre away, all others where the last one ended. It must get there, too."""
    calibration = data_file("kitti_hdl64e_s2_recovered_db.xml")
    with open_source(data_file("kitti_0013_f052-107.pcap.xz"), calibration=calibration) as source:
        given = list(islice(frames_of(source.packets(), source.sensor), 30, 42))
    for before, frame in pairwise(given):
        history = RangeHistory()
        history.remember(before.range_u16, before.azimuth, before.fired, before.sensor)
        seen = (frame.range_u16, frame.azimuth, frame.fired.view(np.uint8), beam_rows(frame.sensor))
        first, found, _, _, iterations, _ = history.native.find_motion(*seen, STILL.numbers)
        again = history.native.find_motion(*seen, first)[0]
        assert found
        assert iterations < 20  # it ended because it was there
        assert np.abs(first[9:]).max() > 12_000  # steps of 1/16 mm
        assert np.abs(first[9:] - again[9:]).max() < 160
