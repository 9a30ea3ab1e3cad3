"""What a user loses if these fail: a simulated drive that cannot be repeated, that no Velodyne tool reads, or whose
points do not lie on what was simulated."""

from __future__ import annotations

import doctest
import hashlib
import itertools
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from lidarcodec import _native
from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.pipeline import frames_of
from lidarcodec.sensors.status_reader import StatusReader
from lidarcodec.sources import open_source
from lidarcodec.sources.simulator import LABELS, PACKET_NS, SCENES, START_NS, SimulatorSource
from tests.conftest import ROOT
from tests.sweeps import sampled

GROUND = LABELS.index("ground")


def payloads(source: SimulatorSource, count: int) -> list[bytes]:
    return [packet.payload for packet in itertools.islice(source.packets(), count)]


def planes(data):
    """Ranges and intensities (firings, 64) by laser, azimuths (firings, 2) of packets (P, 1206)."""
    blocks = data[:, :1200].reshape(-1, 2, 100)
    cells = blocks[..., 4:].reshape(-1, 2, 32, 3)
    ranges = cells[..., 0].astype(np.uint16) | cells[..., 1].astype(np.uint16) << 8
    azimuth = blocks[..., 2].astype(np.uint16) | blocks[..., 3].astype(np.uint16) << 8
    return ranges.reshape(-1, 64), cells[..., 2].reshape(-1, 64), azimuth


def points(sensor, ranges, azimuth):
    """(firings, 64, 3) float64 metres in the sensor's frame: the ROS formula, written out."""
    c = sensor.calibration
    beta = np.radians(azimuth[:, :1] * 0.01) - c["rot_correction_rad"]
    vert, up, side = c["vert_correction_rad"], c["vert_offset_m"], c["horiz_offset_m"]
    distance = 0.002 * ranges + c["dist_correction_m"]
    level = distance * np.cos(vert) - up * np.sin(vert)
    x = level * np.cos(beta) + side * np.sin(beta)
    y = -level * np.sin(beta) + side * np.cos(beta)
    return np.stack([x, y, distance * np.sin(vert) + up * np.cos(vert)], axis=-1)


@pytest.mark.parametrize("scene", SCENES)
def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(scene):
    first = payloads(SimulatorSource(scene, seed=5), 60)
    assert first == payloads(SimulatorSource(scene, seed=5), 60)
    assert first != payloads(SimulatorSource(scene, seed=6), 60)


def test_packets_are_those_of_an_s2():
    source = SimulatorSource("city", seed=2, only=2 * 348)
    packets = list(source.packets())
    assert len(packets) == 2 * 348
    assert [p.stamp_ns for p in packets[:3]] == [START_NS, START_NS + PACKET_NS, START_NS + 2 * PACKET_NS]
    data = np.frombuffer(b"".join(p.payload for p in packets), np.uint8).reshape(-1, 1206)
    flags = data[:, :1200].reshape(-1, 12, 100)[:, :, :2]
    assert np.all(flags[:, 0::2] == [0xFF, 0xEE])
    assert np.all(flags[:, 1::2] == [0xFF, 0xDD])
    _, _, azimuth = planes(data)
    assert np.array_equal(azimuth[:, 0], azimuth[:, 1])
    assert np.all(azimuth % 9 == 0)
    steps = np.diff(azimuth[:, 0].astype(int)) % 36000
    assert set(np.unique(steps)) == {9, 18}
    assert 0.12 < np.mean(steps == 9) < 0.17
    wraps = np.flatnonzero(np.diff(azimuth[:, 0].astype(int)) < 0)
    assert 2140 <= int(np.diff(wraps)[0]) <= 2170
    gps = data[:, 1200:1204].copy().view("<u4")[:, 0].astype(int)
    assert set(np.diff(gps)) == {288, 289}


def test_most_values_of_range_and_intensity_and_most_of_the_rays_are_used():
    data, _, _ = SimulatorSource("city", seed=4).truth(696)
    ranges, intensity, _ = planes(data)
    assert 0.78 < np.mean(ranges > 0) < 0.93
    assert len(np.unique(intensity)) > 200
    assert not intensity[ranges == 0].any()
    assert np.unique(ranges & 15).size == 16


@pytest.mark.parametrize("scene", SCENES)
def test_points_decoded_with_its_calibration_lie_on_the_surfaces(scene):
    source = SimulatorSource(scene, seed=4)
    data, distance_m, _ = source.truth(348)
    ranges, _, _ = planes(data)
    seen = ranges > 0
    error = (0.002 * ranges + source.sensor.calibration["dist_correction_m"] - distance_m)[seen]
    assert abs(np.median(error)) < 0.001
    assert 0.004 < np.median(np.abs(error)) < 0.012
    assert np.mean(np.abs(error) < 0.05) > 0.9  # the rest: slanting ground, and edges where two echoes are one


@pytest.mark.parametrize("scene", sampled(SCENES, ["city"]))
def test_ground_points_lie_on_the_ground_when_moved_by_the_true_poses(scene):
    source = SimulatorSource(scene, seed=7)
    data, _, labels = source.truth(1400)
    ranges, _, azimuth = planes(data)
    stamps = START_NS + np.arange(len(ranges)) // 6 * PACKET_NS + np.arange(len(ranges)) % 6 * (PACKET_NS // 6)
    T = source.poses(stamps)
    local = points(source.sensor, ranges, azimuth)
    world = np.einsum("fij,flj->fli", T[:, :3, :3], local) + T[:, None, :3, 3]
    pick = (labels == GROUND) & (ranges > 0) & (ranges < 8000)
    pick[: len(pick) // 2] = False  # a drive's start proves little
    chosen = world[pick][::97]
    height = source.ground_height(chosen[:, :2])
    rise = chosen[:, 2] - height
    assert len(chosen) > 50
    assert abs(np.median(rise)) < 0.01
    assert np.quantile(np.abs(rise), 0.8) < 0.07  # grass stands up to 7 cm


def test_poses_can_be_asked_in_any_order_and_the_car_moves_like_a_car():
    source = SimulatorSource("city", seed=3)
    stamps = START_NS + np.arange(0, 60 * 10**9, 10**8)
    T = source.poses(stamps)
    again = source.poses(stamps[::-1])[::-1]
    assert np.array_equal(T, again)
    assert np.allclose(T[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1), np.eye(3), atol=1e-9)
    speed = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / 0.1
    assert speed.max() < 15.0
    assert np.abs(np.diff(speed)).max() < 1.0  # no jumps: at most 7 m/s2 and the road's roughness
    heading = np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
    assert np.ptp(heading) > 1.0  # it turns
    assert source.poses.at(source.drive_ns - 1) is None
    with pytest.raises(SourceError, match="first 30 days"):
        source.poses([0])


def test_the_hard_roads_are_hard_in_different_ways():
    """More seeds of one road would only repeat what that road shows of a localiser."""
    stamps = START_NS + np.arange(0, 60 * 10**9, 10**9)
    turned, vehicles = {}, {}
    for scene in ("road", "bend", "motorway"):
        source = SimulatorSource(scene)
        T = source.poses(stamps)
        turned[scene] = np.ptp(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
        _, _, labels = source.truth(700)
        vehicles[scene] = np.mean(labels == LABELS.index("vehicle"))
    assert turned["bend"] > 0.5 > 3 * turned["road"] > turned["motorway"]
    assert vehicles["motorway"] > 1.5 * vehicles["road"]
    assert vehicles["road"] > 0.01


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_car_gets_through_the_town_and_stops_now_and_then(seed):
    stamps = START_NS + np.arange(0, 900 * 10**9, 5 * 10**8)
    at = SimulatorSource("city", seed).poses(stamps)[:, :2, 3]
    stands = np.linalg.norm(np.diff(at, axis=0), axis=1) < 0.05
    changes = np.flatnonzero(np.diff(np.concatenate([[0], stands, [0]])))
    stops = (changes[1::2] - changes[::2]) * 0.5
    assert len(stops) > 2
    assert stops.max() < 60.0
    assert stands.mean() < 0.2
    assert np.ptp(at, axis=0).max() > 300.0


@pytest.mark.sweep
def test_a_public_reader_finds_the_calibration_in_the_status_bytes():
    hdl64e = pytest.importorskip("velodyne_decoder").hdl64e
    source = SimulatorSource("street", seed=1)
    stream = payloads(source, 4400)[100:]
    metadata = hdl64e.read_status_info(stream)
    assert metadata["Model"] == "S2"
    assert metadata["Current Time"].year == 2026
    lasers = hdl64e.status_info_to_calib_dict(metadata)["lasers"]
    for name, field in [
        ("rot_correction", "rot_correction_rad"),
        ("vert_correction", "vert_correction_rad"),
        ("dist_correction", "dist_correction_m"),
        ("dist_correction_x", "dist_correction_x_m"),
        ("vert_offset_correction", "vert_offset_m"),
        ("horiz_offset_correction", "horiz_offset_m"),
        ("focal_distance", "focal_distance_m"),
    ]:
        assert [laser[name] for laser in lasers] == pytest.approx(source.sensor.calibration[field], abs=2e-7)


def test_our_reader_finds_exactly_the_calibration_that_was_simulated():
    source, reader = SimulatorSource("street", seed=1), StatusReader()
    for packet in itertools.islice(source.packets(), 4400):
        reader.push(packet.payload)
    assert reader.sensor is not None
    assert reader.sensor.hash == source.sensor.hash


def test_a_scene_is_named_with_its_options():
    with open_source("sim:road?seed=9&frames=1&speed=5&traffic=0.5") as source:
        assert sum(1 for _ in source.packets()) in (358, 359, 360)
        assert source.label == "simulated road, seed 9"
    with open_source("sim:road?seed=9&packets=350") as source:
        assert sum(1 for _ in source.packets()) == 350
    with pytest.raises(SourceError, match="not both"):
        open_source("sim:road?packets=350&frames=1")
    with pytest.raises(SourceError, match="packets"):
        open_source("sim:road?packets=350&sensor=vlp16")
    with pytest.raises(UnknownNameError, match="'village': choose one of city, road, street, bend, motorway"):
        open_source("sim:village")
    with pytest.raises(UnknownNameError, match="'sed': did you mean seed"):
        open_source("sim:city?sed=3")
    for query in ("seed=-1", "seed=x", "frames=0", "frames=1.5", "skip=-1", "speed=nan", "speed=99", "traffic=-1"):
        with pytest.raises(SourceError, match=query.partition("=")[0]):
            open_source(f"sim:city?{query}")
    with pytest.raises(SourceError, match="speed"):
        SimulatorSource(speed=0.1)


@pytest.mark.parametrize("seed", [1, 3])
def test_frames_are_whole_turns(seed):
    """A first look that shows a sixth of a turn is no look."""
    source = SimulatorSource("road", seed=seed, frames=3)
    frames = list(frames_of(source.packets(), source.sensor))
    assert [frame.width for frame in frames] == pytest.approx([2154] * 3, abs=6)
    assert all(frame.azimuth[0, 0] < 120 for frame in frames)
    assert frames[0].stamp_ns == source.start_ns == START_NS


def test_a_drive_can_be_joined_late_and_is_then_where_it_would_have_been():
    late, whole = SimulatorSource("street", seed=2, skip=2), SimulatorSource("street", seed=2)
    joined = next(late.packets())
    skipped = next(packet for packet in whole.packets() if packet.stamp_ns >= late.start_ns)
    assert late.start_ns == joined.stamp_ns == skipped.stamp_ns
    assert 2 * 348 <= (late.start_ns - whole.start_ns) // PACKET_NS < 3 * 348
    assert joined.payload[1200:] == skipped.payload[1200:]
    same = np.frombuffer(joined.payload, np.uint8) == np.frombuffer(skipped.payload, np.uint8)
    assert same.mean() > 0.95  # echoes at edges remember the firing before


def test_a_drive_through_the_town_begins_at_once():
    """Nobody waits for ground that no beam reaches: the first packets cost less than a turn."""
    simulator, took = _native.Simulator("city", 7, 0.0, 1.0, START_NS), []
    for count in (29, 348):
        began = time.thread_time()
        simulator.packets(count)
        took.append(time.thread_time() - began)
    assert took[0] < took[1]


@pytest.mark.sweep
def test_the_world_ends_nowhere_and_memory_is_flat():
    if not Path("/proc/self/statm").exists():
        pytest.skip("needs /proc to read this process's memory")
    simulator = _native.Simulator("city", 1, 0.0, 1.0, START_NS)

    def hop(times: int) -> int:
        for _ in range(times):
            simulator.skip(20_000)
            simulator.packets(12)
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

    after_a_minute = hop(12)
    assert hop(40) < after_a_minute + 30e6  # 230 s and 2 km further


def test_poses_can_be_asked_from_several_threads():
    source = SimulatorSource("city", seed=3)
    stamps = [START_NS + k * 10**8 for k in range(200)]
    alone = source.poses(stamps)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(source.poses.at, stamps))
    assert np.array_equal(alone, np.stack(together))


def test_the_examples_of_its_page_run():
    failed, tried = doctest.testfile(str(ROOT / "docs" / "simulator.md"), module_relative=False)
    assert tried >= 6
    assert failed == 0


def test_closing_ends_the_drive():
    source = SimulatorSource("street")
    taken = 0
    for _ in source.packets():
        taken += 1
        if taken == 40:
            source.close()
    assert taken < 100


def test_the_drive_is_the_same_however_it_is_cut():
    whole = hashlib.sha256(b"".join(payloads(SimulatorSource("city", seed=8), 116))).hexdigest()
    data, _, _ = SimulatorSource("city", seed=8).truth(116)
    assert hashlib.sha256(data.tobytes()).hexdigest() == whole


def test_vehicles_and_people_lie_in_the_boxes_of_road_users() -> None:
    """Of a short piece of a turn, in which nothing moves far."""
    source = SimulatorSource("city", 4, skip=40)
    data, distance_m, labels = source.truth(40)
    ranges, _, azimuth = planes(data)
    there = points(source.sensor, np.where(distance_m > 0, ranges, 0), azimuth)
    stamp_ns = source.start_ns + 20 * PACKET_NS
    pose = source.poses([stamp_ns])[0]
    world = there @ pose[:3, :3].T + pose[:3, 3]
    inside = np.zeros(labels.shape, bool)
    for user in source.road_users(stamp_ns):
        c, s = np.cos(user["yaw_rad"]), np.sin(user["yaw_rad"])
        x, y, z = (world[..., axis] - user[name] for axis, name in enumerate("xyz"))
        along = np.stack((c * x + s * y, c * y - s * x, z), axis=-1)
        half = np.array([user["length_m"], user["width_m"], user["height_m"]]) / 2 + 0.25
        inside |= np.all(np.abs(along) < half, axis=-1)
    used = np.isin(labels, [LABELS.index("vehicle"), LABELS.index("person")]) & (ranges > 0) & (distance_m > 3)
    used &= distance_m < 75
    assert np.count_nonzero(used) > 300
    assert np.count_nonzero(used & inside) > 0.97 * np.count_nonzero(used)


def test_road_users_are_the_same_for_every_order_of_times() -> None:
    source = SimulatorSource("motorway", 1)
    late, early = source.road_users(source.start_ns + 10**9), source.road_users(source.start_ns)
    again = SimulatorSource("motorway", 1).road_users(source.start_ns)
    assert np.array_equal(early, again)
    assert len(early) > 4
    assert set(early["id"]) & set(late["id"])
    for stamp_ns, reach_m in ((source.start_ns - 10**10, 80.0), (source.start_ns, 0.0), (source.start_ns, 1e3)):
        with pytest.raises(SourceError):
            source.road_users(stamp_ns, reach_m)
