"""If these fail, networks learn from what the codec never sees, or a run that was stopped mixes two runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="training needs torch: the extra `learned`")

from lidarcodec.errors import SettingsError
from lidarcodec.frame import Frame
from lidarcodec.sources.simulator import SimulatorSource
from lidarcodec.training.riddle.drives import frames_to_learn
from lidarcodec.training.riddle.extraction import row_bytes
from lidarcodec.training.riddle.samples import Gathering, SampleStore, clip_samples
from tests.command_line import run_here

HOW = Gathering(seed=5, frame_rows=300)
DRIVE = "sim:road?frames=4"


@pytest.fixture(scope="module")
def drive() -> list[Frame]:
    return list(frames_to_learn(SimulatorSource("road", 2, 4), "packets"))


@pytest.fixture(scope="module")
def gathered(tmp_path_factory: pytest.TempPathFactory) -> SampleStore:
    store = SampleStore(tmp_path_factory.mktemp("run"), "training", HOW, [DRIVE], [])
    store.gather(lambda _: None)
    return store


def test_samples_are_inputs_a_leaf_and_offset_bits(drive: list[Frame]) -> None:
    alone, expecting = clip_samples(drive, 11, 2000, np.random.default_rng(1))
    assert alone.shape[1] == row_bytes(False) == 90
    assert expecting.shape[1] == row_bytes(True) == 130
    assert 1700 < len(alone) < 2300  # of one frame
    assert 3400 < len(expecting) < 4600  # of all but the first two
    for rows in (alone, expecting):
        assert set(np.unique(rows[:, -18])) == set(range(16))
        bits = rows[:, -17:-14]
        assert set(np.unique(bits)) == {-1, 0, 1}
        assert not ((bits[:, :-1] == -1) & (bits[:, 1:] != -1)).any()  # there is no second bit without a first
    (again, _) = clip_samples(drive, 11, 2000, np.random.default_rng(1))
    assert np.array_equal(again, alone)


def test_what_is_expected_is_told(drive: list[Frame]) -> None:
    """What lay further on a turn ago draws ranges to its side."""
    rows = clip_samples(drive, 11, 2000, np.random.default_rng(1))[1]
    further, leaf = rows[:, 77].astype(int), rows[:, -18].astype(int)
    away, near, closer = (leaf[which].mean() for which in (further > 40, np.abs(further) < 8, further < -40))
    assert away > near + 0.3
    assert closer < near - 0.3


def test_single_frames_teach_networks_alone(drive: list[Frame]) -> None:
    alone, expecting = clip_samples(drive[:1], 1, 500, np.random.default_rng(1))
    assert len(alone) > 300
    assert len(expecting) == 0


@pytest.mark.sweep
def test_a_store_that_is_full_is_left_as_it_is(gathered: SampleStore, tmp_path: Path) -> None:
    first = [rows.copy() for rows in gathered.rows(True)]
    said: list[str] = []
    gathered.gather(said.append)
    assert said == []
    anew = SampleStore(tmp_path, "training", HOW, [DRIVE], [])
    (tmp_path / "training").mkdir()
    (tmp_path / "training" / "000-00000-alone.new").write_bytes(b"cut")  # of a run that was stopped
    anew.gather(said.append)
    assert len(said) == 1
    assert all(np.array_equal(a, b) for a, b in zip(first, anew.rows(True), strict=True))
    assert sum(map(len, anew.some(True, 100))) <= 100


def test_samples_of_something_else_are_not_gone_on_with(gathered: SampleStore) -> None:
    folder = gathered.folder.parent
    other = SampleStore(folder, "training", Gathering(seed=6, frame_rows=300), [DRIVE], [])
    with pytest.raises(SettingsError, match="another folder"):
        other.gather(lambda _: None)


@pytest.mark.sweep
def test_samples_of_another_capture_of_the_same_name_are_not_gone_on_with(tmp_path: Path) -> None:
    """The old networks came out, and said that they were trained on it."""
    capture = tmp_path / "drive.pcap"
    for seed in (2, 3):
        assert run_here("simulate", f"sim:road?seed={seed}", capture, "--frames", 3, "--force").returncode == 0
        store = SampleStore(tmp_path, "training", HOW, [str(capture)], [])
        if seed == 2:
            store.gather(lambda _: None)
    with pytest.raises(SettingsError, match="another folder"):
        store.gather(lambda _: None)


@pytest.mark.parametrize("scans", [False, True])
def test_samples_of_a_capture_that_grew_are_not_gone_on_with(tmp_path: Path, scans: bool) -> None:
    """It was still being copied when the first run began."""
    capture = tmp_path / "drive.pcap"
    assert run_here("simulate", "sim:road", capture, "--frames", 4).returncode == 0
    whole = capture.read_bytes()
    for share in (5, 8):
        capture.write_bytes(whole[: len(whole) * share // 8])
        given: tuple[list[str], list[str]] = ([], [str(capture)]) if scans else ([str(capture)], [])
        store = SampleStore(tmp_path, "training", HOW, *given)
        if share == 5:
            store.gather(lambda _: None)
    with pytest.raises(SettingsError, match="another folder"):
        store.gather(lambda _: None)


def test_sources_without_samples_of_a_kind_are_told_of(tmp_path: Path) -> None:
    store = SampleStore(tmp_path, "training", HOW, [], ["sim:road?frames=1"])
    store.gather(lambda _: None)
    assert sum(map(len, store.rows(False))) > 0
    with pytest.raises(SettingsError, match="expecting"):
        store.rows(True)
