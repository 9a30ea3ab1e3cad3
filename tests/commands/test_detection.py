"""`evaluate detection` from end to end: one command gives the table, for coded frames and for recordings."""

import json

import pytest

from tests.command_line import run_here, the_one_line
from tests.evaluation.detection.test_labels import CAMERA, LINE

SOURCE = "sim:street?frames=1"


@pytest.mark.sweep
def test_settings_and_recordings_stand_beside_the_original(tmp_path):
    recording = tmp_path / "street.mcap"
    assert run_here("encode", SOURCE, str(recording), "--codec", "zstd").returncode == 0
    words = ("evaluate", "detection", SOURCE, "--recording", str(recording))
    ran = run_here(*words, "--codec", "predictive", "--set", "max_error_m=0,0.5", "--json")
    assert ran.returncode == 0, ran.stderr
    original, exact, coarse, recorded = json.loads(ran.stdout)
    assert [one["codec"] for one in (original, exact, coarse, recorded)] == [
        "original", "predictive", "predictive", "zstd",
    ]  # fmt: skip
    assert original["found"] == exact["found"] == recorded["found"]
    assert exact["ground_iou"] == recorded["ground_iou"] == 1 > coarse["ground_iou"]
    assert exact["kbps"] > 2 * coarse["kbps"]
    assert recorded["failed"] == 0
    assert recorded["kbps"] > exact["kbps"]
    table = run_here(*words)
    assert table.returncode == 0, table.stderr
    assert "street.mcap" in table.stdout.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "named"),
    [(["sim:street"], "--frames"), (["drive.pcap"], "--labels"), (["sim:road?frames=1&traffic=0"], "no vehicle"),
     ([SOURCE, "--first-label", "3"], "--labels"),
     ([SOURCE, "--labels", "nowhere.txt"], "nowhere.txt"), ([SOURCE, "--codec", "best"], "best"),
     ([SOURCE, "--set", "target_kbps=auto"], "target_kbps"), ([SOURCE, "--recording", "nowhere.mcap"], "nowhere.mcap"),
     ([SOURCE, "--poses", "nowhere.npz"], "nowhere.npz")],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line(words, named):
    ran = run_here("evaluate", "detection", *words)
    assert ran.returncode in (1, 2)
    assert named in the_one_line(ran)


def test_labels_that_are_all_of_other_frames_are_noticed(tmp_path):
    labels, camera = tmp_path / "0.txt", tmp_path / "calib.txt"
    labels.write_text(LINE.format(x=0, y=1.6, z=12, turn=0))
    camera.write_text(CAMERA)
    words = ("evaluate", "detection", SOURCE, "--labels", str(labels), "--camera", str(camera))
    ran = run_here(*words)
    assert ran.returncode in (1, 2)
    assert "--first-label" in the_one_line(ran)
    ran = run_here(*words, "--first-label", "3", "--codec", "zstd", "--json")
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout)[0]["labels"] == "labels"


def test_a_recording_of_two_layers_costs_both(tmp_path):
    """Its frames are scored as they are refined: for the bits of the base alone that would be a bargain."""
    recording = tmp_path / "street.mcap"
    words = ("--codec", "predictive", "--set", "base_error_m=0.2", "--json")
    coded = run_here("encode", SOURCE, str(recording), *words)
    assert coded.returncode == 0, coded.stderr
    size = json.loads(coded.stdout)
    ran = run_here("evaluate", "detection", SOURCE, "--recording", str(recording), "--detector", "none", "--json")
    assert ran.returncode == 0, ran.stderr
    _, recorded = json.loads(ran.stdout)
    assert recorded["ground_iou"] == 1
    assert size["refinement_bytes"] > 0
    assert recorded["bytes_per_frame"] == size["coded_bytes"]


@pytest.mark.parametrize(
    "other", ["sim:street?frames=1&seed=2", "sim:room?frames=1", "sim:street?frames=1&sensor=vlp16"]
)
def test_the_recording_of_another_drive_is_refused(tmp_path, other):
    """Simulated drives, and sensors whose clock nobody set, have the same times: it was scored by boxes of SOURCE."""
    recording = tmp_path / "other.mcap"
    assert run_here("encode", other, str(recording)).returncode == 0
    ran = run_here("evaluate", "detection", SOURCE, "--recording", str(recording), "--detector", "none")
    assert ran.returncode == 1
    assert "not made from this source" in the_one_line(ran)
