"""`evaluate localisation` from end to end: one command gives the table, the pictures, and the bitrate of 5 cm."""

import json

import pytest

from lidarcodec.commands.bench.curve import POINTS
from tests.command_line import run_here, the_one_line

SOURCE = "sim:street?frames=9&traffic=0"


@pytest.mark.sweep
def test_reductions_stand_side_by_side_with_pictures(tmp_path):
    ran = run_here(
        "evaluate", "localisation", SOURCE, "--reduction", "voxel,columns:12", "--map", "own",
        "--protocol", "track", "--keep-points", "4000", "--plots", str(tmp_path), "--json",
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert [(one["reduction"], one["map"], one["codec"]) for one in found] == [
        ("voxel", "own", "predictive"),
        ("columns:12", "own", "predictive"),
    ]
    assert found[0]["keep_points"] == 4000
    assert found[0]["settings"]["max_error_m"] == 0.01
    assert found[0]["track"]["of"] == found[1]["track"]["of"] == 3
    for picture in ("errors-1-track.png", "maps-1.png"):
        assert (tmp_path / picture).stat().st_size > 5000


@pytest.mark.sweep
def test_a_sweep_says_at_which_bitrate_the_error_is_five_centimetres(tmp_path, monkeypatch):
    monkeypatch.setitem(POINTS, "max_error_m", (0.0, 0.05, 0.5))
    ran = run_here(
        "evaluate", "localisation", SOURCE, "--sweep", "--codec", "predictive", "--localiser", "plane",
        "--cache", str(tmp_path / "cache"), "--plots", str(tmp_path / "plots"), "--stride", "5",
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert "5 cm RMSE, near, sim:street?frames=9&traffic=0, predictive, voxel, plane: " in ran.stdout
    assert (tmp_path / "plots" / "sweep-1-near.png").stat().st_size > 5000
    # the original is not looked for twice: what was decoded without loss is the same cloud
    assert len(list((tmp_path / "cache").glob("*.npz"))) == 3


@pytest.mark.parametrize(
    ("words", "named"),
    [(["sim:street"], "--frames"), ([SOURCE, "--map", "half"], "--map"), ([SOURCE, "--reduction", "best"], "best"),
     ([SOURCE, "--localiser", "ndt"], "--localiser"), ([SOURCE, SOURCE, "--poses", "p.npz"], "--poses"),
     (["drive.pcap"], "drive.pcap")],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line(words, named):
    ran = run_here("evaluate", "localisation", *words)
    assert ran.returncode in (1, 2)
    assert named in the_one_line(ran)
