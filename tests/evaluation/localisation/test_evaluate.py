"""The evaluation whole, on a few frames of a simulated street: is what it says of a method true?"""

import json

import numpy as np
import pytest

from lidarcodec.evaluation.localisation.cache import Cache, digest
from lidarcodec.evaluation.localisation.coding import Received
from lidarcodec.evaluation.localisation.counts import Counted, travelled
from lidarcodec.evaluation.localisation.evaluate import Evaluation, Options, Outcome
from lidarcodec.evaluation.localisation.fitting import fitted
from lidarcodec.evaluation.localisation.methods import methods
from lidarcodec.evaluation.localisation.protocol import counted_errors, judged, scored_frames
from lidarcodec.evaluation.localisation.report import over_drives, text_tables
from lidarcodec.evaluation.localisation.sweep import against_original, crossing, crossings
from lidarcodec.evaluation.rigid import moved
from lidarcodec.settings import StreamSettings

DRIVE = "sim:street?frames=13&traffic=0"
SMALL = StreamSettings(codec="predictive", max_error_m=0.01, intensity="off")


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory):
    options = Options(maps=("whole", "own"), receivers=("decoded",), protocols=("track", "starts"))
    return Evaluation(DRIVE, options, Cache(tmp_path_factory.mktemp("cache")))


@pytest.fixture(scope="module")
def voxel(evaluation):
    return evaluation.method(methods(["voxel"], [SMALL], [3000])[0])


@pytest.mark.parametrize("stride", [1, 2, 3, 5])
@pytest.mark.parametrize("count", [2, 3, 12, 100])
def test_a_scored_scan_is_never_in_the_map(count, stride):
    scored = scored_frames(count, stride)
    assert not set(scored.all) & set(scored.mapped.tolist())
    assert all(0 < at < count for at in scored.all)
    assert all(0 <= at < count for at in scored.mapped)
    assert len(scored.mapped) == -(-count // 5)


@pytest.mark.parametrize("stride", [2, 3, 4, 5, 15])
def test_every_step_of_the_track_is_as_long(stride):
    """A scan that gives way to the map would make the next step a third longer: at 12 m/s 5 m and not 3.7, as far as
    the search looks at all, and what is lost there says nothing of the reducer."""
    scored = scored_frames(161, stride)
    assert set(np.diff(scored.tracked).tolist()) == {stride}
    assert np.diff(scored.mapped).max() <= 6


@pytest.mark.sweep
def test_a_reduced_scan_finds_its_place(voxel):
    assert [(one.result["map"], one.result["receiver"]) for one in voxel] == [("whole", "decoded"), ("own", "decoded")]
    for outcome in voxel:
        result = outcome.result
        assert result["track"]["lost"] == 0
        assert result["track"]["of"] == 4
        assert 1e-4 < result["track"]["mate_m"] < 0.03
        assert result["starts"]["found"] == 1.0
        assert result["points_per_frame"] == 3000
        assert 2000 < result["bytes_per_frame"] < 8_000
        assert result["kbps"] == pytest.approx(result["bytes_per_frame"] * 8 / 103.4, rel=0.01)
        assert result["reference"] == {"kind": "exact", "noise_m": None, "noise_deg": None, "slide_m": None}
        # three scans of 3,000 points, thinned by the cells of the map, of some 116,000 returns each
        assert 3000 < result["map_points"] < 9_000
        assert result["r_c"] == pytest.approx(result["map_points"] / 350_000, rel=0.1)
        json.dumps(result)


def test_the_same_again_comes_from_the_cache_and_says_the_same(evaluation, voxel, monkeypatch):
    def never(*_):
        raise AssertionError("computed again")

    monkeypatch.setattr(evaluation, "_estimates", never)
    again = evaluation.method(methods(["voxel"], [SMALL], [3000])[0])
    assert [one.result for one in again] == [one.result for one in voxel]


def test_a_cloud_that_says_nothing_is_lost_and_counted(evaluation):
    """A handful of points of a street is no place; the paper's table would hide that behind a small mean."""
    scored = evaluation.scored
    poses = evaluation.reference.poses
    off = poses[scored.tracked].copy()
    off[1, 0, 3] += 3.0
    off[2, 0, 3] += 0.7
    errors = {
        "trans_m": np.linalg.norm((off - poses[scored.tracked])[:, :3, 3], axis=1),
        "rot": np.zeros(len(off)), "ape": np.zeros(len(off)), "angle_deg": np.zeros(len(off)),
    }  # fmt: skip
    found = judged("track", errors, seed=1)
    assert (found["of"], found["lost"], found["bad"]) == (4, 1, 2)
    assert found["mate_m"] == 0.0


@pytest.mark.parametrize("dear", [0.7, 1.3, 2.5])
def test_equal_bytes_are_equal_whatever_a_point_costs(dear):
    """A point costs the less the more there are, and a frame something by itself."""

    def size(points):
        return round(dear * points**0.95 + 60)

    def send(method, wanted, only):
        assert len(wanted) == 0
        return Received(sizes=[size(method.points)] * len(only), points=[method.points] * len(only))

    asked = methods(["harris"], [SMALL], [9000], frame_bytes=12_500)[0]
    assert size(fitted(asked, send).points) == pytest.approx(12_500, rel=0.01)
    as_it_is = methods(["harris"], [SMALL], [9000])[0]
    assert fitted(as_it_is, send) is as_it_is


@pytest.mark.sweep
def test_the_oracles_prefer_what_many_scans_saw(evaluation):
    """Counted over the whole drive, a facade outlives a car."""
    at = evaluation.scored.all[0]
    counts = evaluation._counts(at)
    sent = {}
    for name in ("oracle", "oracle-static", "iss"):
        method = methods([name], [SMALL], [3000])[0]
        frame = evaluation._sent(method, [at]).frames[at]
        cloud = moved(evaluation.reference.poses[at], evaluation._cloud(at, frame))
        sent[name] = evaluation._counted.of(cloud).mean()
    assert sent["oracle"] > 1.3 * counts.mean()
    assert sent["oracle"] > sent["oracle-static"] > sent["iss"]


def test_a_standing_car_learns_nothing_by_standing():
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = [0, 0.01, 0.02, 0.6, 0.61, 1.2]
    assert travelled(poses) == [0, 3, 5]


def test_a_return_far_from_every_place_counts_nothing():
    counted = Counted(np.array([[0.0, 0, 0], [10, 0, 0]]), np.array([7, 9], np.int32))
    assert counted.of(np.array([[0.4, 0, 0], [0.6, 0, 0], [10, 0.1, 0]])).tolist() == [7, 0, 9]


def fake(source, metres, lost=0):
    values = np.array([*metres, *[5.0] * lost])
    errors = {"trans_m": values, "rot": values * 0, "ape": values, "angle_deg": values * 0}
    result = {
        "source": source, "reduction": "all", "keep_points": None, "codec": "raw", "map": "whole",
        "receiver": "decoded", "localiser": "plane", "settings": SMALL.model_dump(), "points_per_frame": 10.0,
        "bytes_per_frame": 100.0, "kbps": 8.0, "map_points": 50, "r_c": 0.1, "frames": 3, "metres": 4.0,
        "reference": {"kind": "refined", "noise_m": 0.001, "noise_deg": 0.01, "slide_m": [0.01, 0.02, 0.04]},
        "track": judged("track", errors, 1),
    }  # fmt: skip
    return Outcome(result, {"track": errors})


def test_drives_are_put_together_by_method_and_what_was_lost_is_added_up():
    outcomes = [fake("a", [0.01, 0.02]), fake("b", [0.04] * 20, lost=2)]
    (found,) = over_drives(outcomes, seed=1)
    assert found["source"] == "2 drives"
    assert found["track"]["mate_m"] == pytest.approx((0.015 + 0.04) / 2)
    assert (found["track"]["lost"], found["track"]["of"]) == (2, 24)
    assert found["track"]["mate_m_error"] > 0.005
    assert over_drives(outcomes[:1], seed=1) == []


def test_the_table_says_what_reference_there_was_and_how_uncertain_it_is():
    text = text_tables([fake("a", [0.01, 0.02]).result])
    assert (
        "reference refined, uncertain by 1.0 mm and 0.010 degrees; over 0.8 s 10 / 20 / 40 mm forward, left, up" in text
    )
    assert "0 of 2" in text


def test_a_drive_too_short_for_a_protocol_has_a_dash_in_the_table_and_no_part_in_the_mean():
    outcomes = [fake("a", [0.01, 0.02]), fake("b", [0.01])]
    for outcome, metres in zip(outcomes, ([0.05, 0.05, 3.0, 3.0], []), strict=True):
        values = np.array(metres)
        errors = {"trans_m": values, "rot": values * 0, "ape": values, "angle_deg": values * 0}
        outcome.result["starts"], outcome.errors["starts"] = judged("starts", errors, 1), errors
    assert "- of 0" in text_tables([outcomes[1].result])
    assert over_drives(outcomes, seed=1)[0]["starts"]["found"] == 0.5
    assert over_drives(outcomes[1:] * 2, seed=1)[0]["starts"]["found"] is None


def test_against_the_original_counts_what_only_the_decoded_cloud_lost():
    original, decoded = fake("a", [0.01, 0.02, 0.01], lost=1), fake("a", [0.01, 0.02, 0.01], lost=1)
    places = np.tile(np.eye(4), (4, 1, 1))
    original.estimates["track"], decoded.estimates["track"] = places, places.copy()
    decoded.estimates["track"][:, 0, 3] = [0.03, 0.04, 2.0, 0.0]
    found = against_original(decoded, original, seed=1)["track"]
    assert (found["of"], found["bad"]) == (3, 1)
    assert found["rmse_m"] == pytest.approx(np.sqrt((0.03**2 + 0.04**2) / 2))


def test_the_bitrate_of_five_centimetres_lies_between_two_settings():
    assert crossing([(2000, 0.025), (500, 0.2), (1000, 0.1)]) == {"kbps": 1414.2, "is": "at"}
    assert crossing([(500, 0.2), (1000, 0.06)]) is None
    assert crossing([(500, 0.02)]) == {"kbps": 500, "is": "below"}
    assert crossing([]) is None


def test_crossings_are_told_apart_by_codec():
    results = []
    for codec, kbps, rmse in (("a", 100, 0.1), ("a", 400, 0.025), ("b", 100, 0.01)):
        result = fake("x", [0.01]).result | {"codec": codec, "kbps": kbps}
        results.append(result | {"against_original": {"track": {"rmse_m": rmse}}})
    found = {one["codec"]: one["at_5_cm"] for one in crossings(results, "track")}
    assert found == {"a": {"kbps": 200.0, "is": "at"}, "b": {"kbps": 100, "is": "below"}}


def test_a_cache_file_that_is_broken_is_made_again(tmp_path):
    kept = Cache(tmp_path)
    name = digest("x", np.arange(3))
    (tmp_path / f"{name}.npz").write_bytes(b"not an archive")
    assert kept.arrays(name, lambda: {"v": np.ones(2)})["v"].tolist() == [1, 1]
    assert kept.arrays(name, lambda: {"v": np.zeros(2)})["v"].tolist() == [1, 1]
    assert digest("x", np.arange(3)) != digest("x", np.arange(4))
    assert digest("x", np.arange(3)) != digest("x", np.arange(3.0))


def test_counted_errors_are_those_of_the_mean(voxel):
    outcome = voxel[0]
    assert counted_errors("track", outcome.errors["track"]).mean() == pytest.approx(outcome.result["track"]["mate_m"])
