"""What a user loses if these fail: a simulated sensor whose packets are taken for another's, whose points do not lie on
what was simulated, or whose firing times do nothing."""

from __future__ import annotations

import doctest
import itertools
from dataclasses import replace

import numpy as np
import pytest

import lidarcodec.sources.spinning.source
import lidarcodec.sources.spinning.table
from lidarcodec import _native
from lidarcodec.api import read_frames
from lidarcodec.commands import simulate
from lidarcodec.errors import SettingsError, SourceError, UnknownNameError
from lidarcodec.sensor_model import Calibration
from lidarcodec.sensors.images import Images
from lidarcodec.sensors.models.ouster.fields import PIXELS
from lidarcodec.sensors.models.table import detect, is_ouster
from lidarcodec.sources import open_source
from lidarcodec.sources.simulator import LABELS, SCENES
from lidarcodec.sources.spinning.encoder import TURN_NS
from lidarcodec.sources.spinning.source import SpinningSource
from lidarcodec.sources.spinning.table import HESAI, TRAITS, VELODYNE, Wanted, detector_of, names, unit_of
from tests.sweeps import sampled

GROUND, VEHICLE, PERSON = (LABELS.index(name) for name in ("ground", "vehicle", "person"))
OUSTER_PROFILES = [Wanted("os1-32", profile=profile) for profile in PIXELS]
ALL = [Wanted(name) for name in names()]
BOTH = [*ALL, *OUSTER_PROFILES, *(Wanted(name, returns="dual") for name in names() if not is_ouster(name))]


def text_of(wanted: Wanted) -> str:
    return "-".join(part for part in wanted if part)


def images_of(source: SpinningSource, payloads):
    """Layout and images of payloads (P, bytes), decoded as those of any capture."""
    layout = source.unit.sensor.layout_of(payloads[0].tobytes())
    assert layout is not None
    assert layout.fits(payloads).all()
    return layout, layout.split(payloads)


@pytest.mark.parametrize("wanted", BOTH, ids=text_of)
def test_packets_are_those_of_the_sensor_and_come_back_from_their_images(wanted):
    source = SpinningSource(wanted, "street", seed=2)
    packets = list(itertools.islice(source.packets(), 6))
    found = detect([packet.payload for packet in packets])
    assert found is not None
    if wanted.sensor.startswith("os"):
        assert found.model == f"ouster-{source.sensor.rows}-{source.unit.layout.name}"
    else:
        assert found.model == source.sensor.model == wanted.sensor
    payloads = np.frombuffer(b"".join(p.payload for p in packets), np.uint8).reshape(len(packets), -1)
    layout, images = images_of(source, payloads)
    assert layout == source.unit.layout
    assert np.array_equal(layout.join(images), payloads)
    assert (images.planes["range"] > 0).any()
    assert np.array_equal(payloads, source.truth(6).payloads)  # the same drive, in one piece


@pytest.mark.parametrize("wanted", ALL, ids=text_of)
def test_points_lie_on_what_was_simulated_and_times_rise(wanted):
    source = SpinningSource(wanted, "street", seed=3, skip=2)
    made = source.truth(source.frame_packets // 6)
    layout, images = images_of(source, made.payloads)
    sensor = source.unit.sensor
    ranges = images.planes["range"]
    seen = (ranges > 0) & (made.distance_m > 0)
    error = (ranges * source.sensor.range_step_m - made.distance_m)[seen]
    traits = detector_of(source.unit)
    assert abs(np.median(error)) < 0.5 * traits["sigma_m"] + 0.6 * traits["step_m"]
    assert np.median(np.abs(error)) < 1.5 * traits["sigma_m"] + traits["step_m"]
    assert np.mean(np.abs(error) < 10 * traits["sigma_m"]) > 0.9

    offsets = sensor.times_ns(layout, images)
    fired = np.repeat(made.stamps_ns, layout.columns) + offsets
    assert np.abs(fired - made.fired_ns).max() < 2  # float32 seconds
    assert (np.diff(made.stamps_ns) > 0).all()
    assert (np.diff(made.fired_ns, axis=1) > 0).all()

    # Points of the ground lie on the ground of the world, by the pose of each firing.
    row, column = np.nonzero((made.labels == GROUND) & seen & (made.distance_m < 25))
    row, column = row[:: 1 + len(row) // 80], column[:: 1 + len(column) // 80]
    local = np.stack([axis[row, column] for axis in sensor.points(source.sensor, layout, images)], axis=-1)
    T = source.poses(np.broadcast_to(made.fired_ns, ranges.shape)[row, column])
    world = np.einsum("nij,nj->ni", T[:, :3, :3], local) + T[:, :3, 3]
    rise = world[:, 2] - source.ground_height(world[:, :2])
    assert len(rise) > 5
    assert abs(np.median(rise)) < 0.03
    assert np.quantile(np.abs(rise), 0.8) < 0.08  # grass stands up to 7 cm


@pytest.mark.parametrize("wanted", ALL, ids=text_of)
def test_beams_begin_where_points_of_range_0_are(wanted):
    unit = unit_of(wanted, 1, 0)
    series, _ = unit.heads(0, 3)
    shape = (unit.layout.rows, 3 * unit.layout.columns)
    images = Images({plane.name: np.zeros(shape, plane.dtype) for plane in unit.layout.planes}, series)
    for ours, theirs in zip(unit.origins(images), unit.sensor.points(unit.model, unit.layout, images), strict=True):
        assert np.abs(ours - theirs).max() < 1e-15


def test_a_turn_is_a_tenth_of_a_second_and_the_whole_horizon():
    for name in ("vlp16", "os0-32", "xt32"):
        source = SpinningSource(Wanted(name), "street", frames=1)
        made = source.truth(source.frame_packets)
        azimuth = source.unit.sensor.azimuth(source.unit.layout, made.images).astype(int)
        span = made.fired_ns.max() - made.fired_ns.min()
        assert span == pytest.approx(TURN_NS, rel=0.04)
        assert (np.diff(azimuth) % 36000).sum() == pytest.approx(36000, rel=0.04)


@pytest.mark.sweep
def test_what_moves_is_where_it_is_when_it_is_fired_at():
    """One beam fired again and again: a moving car comes nearer or goes away at a steady speed."""
    source = SpinningSource(Wanted("os0-32"), "street", seed=1, speed=0.5)
    unit, rows, columns = source.unit, 32, 40
    turns = source.truth(20 * source.frame_packets)
    ahead = np.nonzero((turns.labels == VEHICLE) & (turns.distance_m > 4) & (turns.distance_m < 40))
    speeds = []
    for row, column in list(zip(*ahead, strict=True))[:: max(1, len(ahead[0]) // 400)]:
        series, _ = unit.heads(int(column) // unit.layout.columns, 1)
        shape = (rows, unit.layout.columns)
        images = Images({"range": np.zeros(shape, np.uint32)}, series)
        near = [axis[row, column % unit.layout.columns] for axis in unit.sensor.points(unit.model, unit.layout, images)]
        images.planes["range"][:] = 10_000
        far = [axis[row, column % unit.layout.columns] for axis in unit.sensor.points(unit.model, unit.layout, images)]
        beam = [np.full((rows, columns), value) for value in (*near, *far)]
        start = int(turns.fired_ns[0, column]) - source.drive_ns
        times = start + np.arange(columns, dtype=np.int64)[None] * 1_000_000
        simulator = _native.SpinningSimulator("street", 1, 0.5, 1.0, detector_of(unit), rows)
        *_, distances, labels = simulator.fire(times, np.stack(beam), 10_000 * unit.model.range_step_m)
        if (labels[0] == VEHICLE).all():
            distance = distances[0].astype(float)
            slope, offset = np.polyfit(times[0] * 1e-9, distance, 1)
            if np.abs(distance - slope * times[0] * 1e-9 - offset).max() < 0.02:
                speeds.append(abs(slope))
    assert max(speeds) > 2.0


@pytest.mark.parametrize("sensor", ["vlp16", "xt16", "qt128"])
def test_most_second_returns_are_the_same_as_the_first_and_others_are_nearer(sensor):
    found = [SpinningSource(Wanted(sensor, returns="dual"), scene, skip=40) for scene in ("city", "garage")]
    for source in found:
        planes = source.truth(source.frame_packets).images.planes
        last, strongest = (planes[name].astype(int) for name in ("range", "range2"))
        assert 0.93 < np.mean((last == strongest)[last > 0]) < 0.995
        assert (strongest <= last).all()
        assert np.array_equal(last > 0, strongest > 0)


@pytest.mark.parametrize("sensor", ["pandar40p", "pandar64"])
def test_a_pandar_says_nothing_of_the_reflectivity_of_what_is_near(sensor):
    """In the captures of both, nearly everything nearer than 1.5 m has reflectivity 0."""
    source = SpinningSource(Wanted(sensor), "room", seed=2)
    planes = source.truth(source.frame_packets).images.planes
    metres = planes["range"] * source.sensor.range_step_m
    assert np.mean(planes["intensity"][(metres > 0) & (metres < 1.4)] == 0) > 0.98
    assert np.mean(planes["intensity"][metres > 1.6] == 0) < 0.1


def test_in_the_room_a_sensor_stands_still_among_things_close_by():
    shares = []
    for seed in (1, 2, 3):
        source = SpinningSource(Wanted("pandar40p"), "room", seed=seed)
        places = source.poses(source.start_ns + np.arange(3) * 10**9)[:, :3, 3]
        assert (places == places[0]).all()
        made = source.truth(source.frame_packets)
        assert (made.labels == PERSON).any()
        assert not (made.labels == VEHICLE).any()
        seen = made.images.planes["range"] > 0
        shares.append(np.mean(made.distance_m[seen] < 1))
    assert 0.35 < np.mean(shares) < 0.75
    assert len(set(shares)) == 3


def test_an_ouster_counts_photons_with_and_without_a_return():
    source = SpinningSource(Wanted("os0-32", profile="RNG19_RFL8_SIG16_NIR16_DUAL"), "city", seed=2)
    planes = source.truth(source.frame_packets).images.planes
    seen, metres = planes["range"] > 0, planes["range"] * 0.001
    assert planes["near_ir"][~seen].mean() > 100
    near, far = (planes["signal"][seen & (metres > a) & (metres < b)].mean() for a, b in ((4, 6), (16, 24)))
    assert 8 < near / far < 24  # a sixteenth at four times the distance, for the same surfaces
    assert planes["signal"][~seen].mean() < 8
    second = planes["range2"] > 0
    assert 0.001 < second[seen].mean() < 0.05
    assert (np.abs(metres - planes["range2"] * 0.001)[second] > 2.5).all()


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    first, again, other = (SpinningSource(Wanted("xt16"), "city", seed=seed).truth(20).payloads for seed in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_sensor_is_named_with_its_options():
    with open_source("sim:road?sensor=os0-32&profile=rng15_rfl8_nir8&mode=512x10&frames=1&seed=4") as source:
        assert source.sensor.name == "Ouster OS-0-32, 512x10, RNG15_RFL8_NIR8"
        assert source.label == "simulated road, seed 4, os0-32"
        assert sum(1 for _ in source.packets()) == 32
    with open_source("sim:road?sensor=hdl64e&frames=1") as source:
        assert source.sensor.is_hdl64e
    with open_source("sim:street?sensor=qt64&returns=dual&frames=1") as source:
        assert sum(1 for _ in source.packets()) == 300
    unknown = {
        "sensor=vlp64": "simulated sensor 'vlp64': did you mean vlp16. Otherwise choose one of hdl64e, vlp16",
        "sensor=os1-128&profile=RNG16": "profile 'RNG16': choose one of LEGACY",
        "sensor=os1-128&mode=1024x30": "mode '1024x30': did you mean 1024x10. Otherwise choose one of 512x10",
        "sensor=vlp16&returns=three": "kind of returns 'three': choose one of single, dual",
        "sensor=vlp16&port=1": "'port': choose one of seed",
    }
    for query, text in unknown.items():
        with pytest.raises(UnknownNameError, match=text):
            open_source(f"sim:city?{query}")
    for query in ("sensor=vlp16&profile=LEGACY", "sensor=os1-64&returns=dual", "sensor=vlp16&seed=-1", "mode=512x10"):
        with pytest.raises(SourceError):
            open_source(f"sim:city?{query}")
    with pytest.raises(SourceError, match="truth can be had of 1 to 7600 packets"):
        SpinningSource(Wanted("vlp16")).truth(0)


@pytest.mark.parametrize("scene", SCENES)
def test_every_scene_is_seen(scene):
    made = SpinningSource(Wanted("os1-32"), scene, seed=2).truth(8)
    assert 0.3 < np.mean(made.images.planes["range"] > 0) < 0.98


def test_simulate_writes_captures_that_are_rightly_named(tmp_path, capsys):
    for name, kind in (("vlp16", "VLP-16"), ("os1-32", "Ouster OS-1-32"), ("qt64", "QT64")):
        out = tmp_path / f"{name}.pcap"
        simulate.run(f"sim:street?sensor={name}", out, 1)
        with open_source(out) as source:
            assert kind in source.sensor.name
            assert source.sensor.model == name
        assert " 1 frame" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.glob("*.json")) == ["os1-32.json"]
    (tmp_path / "os1-32.pcap").unlink()
    with pytest.raises(SettingsError, match=r"os1-32\.json"):
        simulate.run("sim:street?sensor=os1-32", tmp_path / "os1-32.pcap", 1)


@pytest.mark.parametrize("name", sampled(["vlp16", "vls128", "qt64", "os1-32"], ["vlp16", "os1-32"]))
def test_a_drive_has_as_many_turns_as_were_asked_for(tmp_path, name):
    assert len(list(read_frames(f"sim:garage?sensor={name}&frames=4"))) == 4
    out = tmp_path / "skipped.pcap"
    simulate.run(f"sim:garage?sensor={name}", out, 3, skip=2)
    frames, drive = list(read_frames(out)), list(read_frames(f"sim:garage?sensor={name}&frames=5"))
    assert [frame.stamp_ns for frame in frames] == [frame.stamp_ns for frame in drive[2:]]


def test_ousters_own_reader_takes_the_metadata_and_finds_the_same_points():
    core = pytest.importorskip("ouster.sdk.core")
    source = SpinningSource(Wanted("os1-64", profile="RNG15_RFL8_NIR8"), "street", seed=3)
    info = core.SensorInfo(source.sensor.description.decode())
    made = source.truth(source.frame_packets)
    ours = np.stack(source.unit.sensor.points(source.sensor, source.unit.layout, made.images), axis=-1)
    theirs = core.XYZLut(info)(made.images.planes["range"].astype(np.uint32) * 8)
    seen = made.images.planes["range"] > 0
    assert seen.any()
    assert np.abs(theirs - ours)[seen].max() < 1e-9


def test_the_examples_in_the_documentation_of_the_modules_run():
    for module in (lidarcodec.sources.spinning.source, lidarcodec.sources.spinning.table):
        assert doctest.testmod(module).attempted > 0
        assert doctest.testmod(module).failed == 0


def test_a_model_without_traits_of_its_own_has_those_of_its_maker(monkeypatch):
    for name, maker in (("vlp16", VELODYNE), ("xt16", HESAI)):
        monkeypatch.delitem(TRAITS, name)
        assert name in names()
        traits = detector_of(unit_of(Wanted(name), 1, 0))
        assert {trait: traits[trait] for trait in maker} == maker


def test_a_beam_that_begins_beside_the_axis_is_cast_from_there(monkeypatch):
    unit = unit_of(Wanted("vlp16"), 1, 0)
    beside = Calibration.from_values({**unit.sensor.generic, "horiz_offset_m": np.full(16, 0.1)})
    monkeypatch.setitem(unit.__dict__, "model", replace(unit.model, calibration=beside))
    series, _ = unit.heads(0, 1)
    images = Images({"range": np.zeros((16, 24), np.uint16)}, series)
    x, y, _ = unit.origins(images)
    assert np.abs(np.hypot(x, y) - 0.1).max() < 1e-6


def test_a_unit_has_what_its_model_has():
    assert unit_of(Wanted("os2-64", mode="2048x10"), 1, 0).turn_packets == 128
    assert unit_of(Wanted("vlp32c", returns="dual"), 1, 0).layout.returns == 2
