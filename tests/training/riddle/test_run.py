"""If these fail, a user cannot train for his own sensor: no file, another file each time, or one that does not say what
it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from typer.testing import CliRunner

from lidarcodec.cli import app
from lidarcodec.errors import SettingsError
from lidarcodec.network.weight_file import read_weights
from lidarcodec.training.riddle.run import RiddleRun, train
from lidarcodec.training.riddle.samples import Gathering

RUN = RiddleRun(
    ("sim:road?frames=3",),
    held=("sim:road?frames=3&seed=2",),
    sizes=("small",),
    steps=40,
    batch=512,
    rate=1e-2,
    gathering=Gathering(frame_rows=800),
    about={"licence": "CC0", "date": "2026-11-21"},
)


@pytest.mark.sweep
def test_a_run_writes_a_file_that_says_what_it_is_and_again_the_same(tmp_path: Path) -> None:
    said: list[str] = []
    weights = train(RUN, tmp_path / "first.lcrw", device="cpu", say=said.append, every=20)
    assert read_weights(tmp_path / "first.lcrw").name == weights.name
    assert [(net.expects, net.size_name) for net in weights.nets] == [(False, "small"), (True, "small")]
    about = weights.provenance
    assert about["trained on"] == ["sim:road?frames=3"]
    assert about["licence"] == "CC0"
    assert [net["steps"] for net in about["networks"]] == [40, 40]
    costs = [float(line.rpartition(" bits")[0].rpartition(" ")[2]) for line in said if ": step" in line]
    assert costs[1] < costs[0]
    assert costs[3] < costs[2]

    again: list[str] = []
    second = train(RUN, tmp_path / "first.lcrw", device="cpu", say=again.append, every=20)
    assert second.data == weights.data
    assert again == []  # nothing was left to do


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--out", "w.lcrw"], "nothing to train on"),
        (["sim:road?frames=2", "--out", "w.lcrw"], "--holdout"),
        (["sim:road", "--holdout", "sim:city?frames=1", "--out", "w.lcrw"], "--frames"),
        (["sim:road?frames=1", "--holdout", "sim:road?frames=1", "--out", "w.lcrw"], "for training and with --holdout"),
        (["sim:road?frames=1", "--holdout", "sim:city?frames=1", "--out", "none/w.lcrw"], "no folder"),
        (["sim:road?frames=1", "--holdout", "sim:city?frames=1", "--out", "w.lcrw", "--size", "huge"], "small, large"),
        (["drive.pcap", "--holdout", "./drive.pcap", "--out", "w.lcrw"], "for training and with --holdout"),
        (["sim:road?frames=1", "--holdout", "sim:city?frames=1", "--out", "."], "give the name of a file"),
        (["none.pcap", "--holdout", "sim:city?frames=1", "--out", "w.lcrw"], "none.pcap"),
    ],
)
def test_the_command_says_what_it_lacks(
    arguments: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.pcap").touch()
    result = CliRunner().invoke(app, ["train", "riddle", *arguments])
    assert result.exit_code != 0
    assert says in str(result.exception) + result.output
    assert not (tmp_path / "w.lcrw").exists()


@pytest.mark.sweep
def test_as_many_weights_stay_as_are_asked_for(tmp_path: Path) -> None:
    wanted = replace(RUN, sizes=("small", "large"), kinds=("alone",), steps=20)
    for tiles, left in ((1.0, [1.0, 1.0]), (0.78, [0.78, 0.78]), (None, [0.6, 0.6])):
        run = replace(wanted, tiles=tiles)
        small, large = train(run, tmp_path / f"{tiles}.lcrw", say=lambda _: None).provenance["networks"]
        assert small["tiles left"] == [1.0, 1.0]
        assert large["tiles left"] == pytest.approx(left, abs=0.05)


def test_what_cannot_be_asked_for_is_refused() -> None:
    for wrong in (
        {"kinds": ("both",)},
        {"sizes": ()},
        {"sizes": ("small", "small")},
        {"simulated": -1},
        {"beside": True},
        {"precision": "half"},
        {"tiles": 0.0},
        {"tiles": 1.1},
        {"tiles": float("nan")},
    ):
        with pytest.raises(SettingsError):
            RiddleRun(("a",), held=("b",), **wrong)
    for field in ({"frame_rows": 0}, {"passes": 0}, {"units": "some"}):
        with pytest.raises(SettingsError):
            Gathering(**field)
