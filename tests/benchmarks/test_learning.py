"""The learning curves in docs/ are those of the result files."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("matplotlib", reason="drawing needs the extra `plot`")

from benchmarks import learning, results


def test_a_curve_becomes_a_result_with_the_command_of_its_training_and_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.results.FOLDER", tmp_path)
    monkeypatch.setattr("benchmarks.learning.PICTURE", tmp_path / "learning.png")
    curve = tmp_path / "curve.csv"
    curve.write_text(
        "step,label_loss,processor_minutes,drive,precision\n"
        "5,1.5,0.2,,\n"  # saved without a measurement
        "9,1.0,0.4,city,0.25\n"
        "9,1.0,0.4,road,0.5\n"
    )
    learning.main(["--keep", "poconet", str(curve), "--trained", "lidarcodec train poconet labels/*"])
    assert results.read("training/poconet").fields["command"] == "lidarcodec train poconet labels/*"
    assert learning.lines("poconet", "label_loss") == {"": [(0.2, 1.5), (0.4, 1.0)]}
    assert learning.lines("poconet", "precision", "drive") == {"city": [(0.4, 0.25)], "road": [(0.4, 0.5)]}
    curve.write_text(
        "step,loss,processor_minutes,drive,step_m,entropy_bits,previous_valid_entropy_bits\n"
        "7,2.5,0.3,kitti_0005,0.022,3.5,3.6\n"
    )
    learning.main(["--keep", "riddle", str(curve), "--trained", "python -m research.riddle_paper train"])
    learning.main([])
    assert (tmp_path / "learning.png").stat().st_size > 1000
