"""What a training on an archive would lose: frames twice or missing, an order that can be repeated, errors."""

from __future__ import annotations

import json
import pickle
import re
import shutil
import sys
from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs torch: the extra `torch`")

from torch.utils.data import DataLoader

import lidarcodec
from lidarcodec.archive.shares import Share, share_of
from lidarcodec.archive.stores.table import open_store
from lidarcodec.errors import MissingExtraError, SettingsError, SourceError
from tests.command_line import run_here

pytestmark = pytest.mark.timeout(300)

FRAMES = 26


@pytest.fixture(scope="module")
def made(drive, tmp_path_factory) -> Path:
    """An archive of two vehicles, whose frames need others."""
    root = tmp_path_factory.mktemp("trained")
    for vehicle in ("car-7", "car-8"):
        (root / "in" / vehicle / "roof").mkdir(parents=True)
        shutil.copy(drive / "car-7/roof/drive.pcap", root / "in" / vehicle / "roof")
    words = ("--workers", "here", "--seconds", "1", "--codec", "predictive")
    done = run_here("archive", "run", str(root / "in"), str(root / "out"), *words)
    assert done.returncode == 0, done.stderr
    return root / "out"


def stamp(frame: lidarcodec.Frame) -> tuple[int, int]:
    return frame.stamp_ns, frame.points


def every(made: Path) -> Counter:
    return Counter(stamp(frame) for frame in lidarcodec.open_archive(made).frames())


def test_each_frame_comes_once_over_all_ranks_and_workers(made):
    expected, found = every(made), Counter()
    assert expected.total() == FRAMES
    for rank in range(2):
        dataset = lidarcodec.open_archive(made).dataset(transform=stamp, rank=rank, world=2)
        found.update(tuple(map(int, one)) for one in DataLoader(dataset, batch_size=None, num_workers=2))
    assert found == expected


@pytest.mark.sweep
def test_an_order_follows_from_seed_and_epoch(made):
    def order(epoch: int, seed: int = 0) -> list:
        dataset = lidarcodec.open_archive(made).dataset(transform=stamp, seed=seed, buffer=4)
        dataset.set_epoch(epoch)
        return list(pickle.loads(pickle.dumps(dataset)))

    assert order(0) == order(0)
    assert Counter(order(0)) == Counter(order(1)) == every(made)
    assert len({str(order(0)), str(order(1)), str(order(0, seed=1))}) == 3


@pytest.mark.sweep
def test_workers_that_stay_take_the_next_epoch(made):
    dataset = lidarcodec.open_archive(made).dataset(transform=stamp)
    loader = DataLoader(dataset, batch_size=None, num_workers=1, persistent_workers=True)
    orders = []
    for epoch in (0, 1, 0):
        dataset.set_epoch(epoch)
        orders.append([tuple(map(int, one)) for one in loader])
    assert orders[0] == orders[2] != orders[1]


def test_frames_can_be_chosen_and_kept_in_order(made):
    archive = lidarcodec.open_archive(made)
    expected = list(archive.frames(vehicle="car-8"))
    found = archive.dataset(vehicle="car-8", shuffle=False)
    assert [stamp(one) for one in found] == [stamp(one) for one in expected]
    between = (expected[2].stamp_ns, expected[4].stamp_ns)
    assert len(list(archive.dataset(vehicle="car-8", between=between, shuffle=False))) == 3
    assert Counter(map(stamp, archive.dataset(where="frame = 1"))) == Counter(
        map(stamp, archive.frames(where="frame = 1"))
    )
    again = archive.dataset(vehicle="car-8", shuffle=False)
    assert archive.dataset(where="frame = 1", shuffle=False).digest != found.digest == again.digest
    shuffled = archive.dataset(vehicle="car-8", seed=1)
    first = shuffled.digest
    shuffled.set_epoch(1)
    assert len({found.digest, first, shuffled.digest, archive.dataset(vehicle="car-8").digest}) == 4


@pytest.mark.sweep
def test_the_ranks_are_those_of_torch_distributed(made):
    """A spawned worker does not know the group of its parent, so they are in what it gets."""
    from torch import distributed
    from torch.testing._internal.distributed.fake_pg import FakeStore

    dataset, found = lidarcodec.open_archive(made).dataset(transform=stamp), Counter()
    early = pickle.dumps(dataset)  # as torch.multiprocessing.spawn hands it to what will be ranks
    for rank in range(2):
        distributed.init_process_group("fake", store=FakeStore(), rank=rank, world_size=2)
        try:
            sent, here = pickle.dumps(dataset), list(dataset)
            assert list(pickle.loads(early)) == here
        finally:
            distributed.destroy_process_group()
        assert list(pickle.loads(sent)) == here
        found.update(here)
    assert found == every(made)


@pytest.mark.sweep
def test_a_bucket_is_read_by_workers_that_are_spawned_and_never_hangs(made, bucket, monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "not-to-be-seen")
    store = open_store("s3://fleet/trained")
    for path in (path for path in made.rglob("*") if path.is_file()):
        store.upload(str(path.relative_to(made)), [path.read_bytes()])
    dataset = lidarcodec.open_archive("s3://fleet/trained").dataset(transform=stamp)
    with pytest.raises(SourceError, match="multiprocessing_context='spawn'"):
        list(DataLoader(dataset, batch_size=None, num_workers=1, multiprocessing_context="fork"))
    loader = DataLoader(dataset, batch_size=None, num_workers=1, multiprocessing_context="spawn")
    assert Counter(tuple(map(int, one)) for one in loader) == every(made)
    assert b"not-to-be-seen" not in pickle.dumps(dataset)


def test_few_segments_are_work_for_many():
    shares = [share_of(["a", "b"], str, Share(number, 5), "0/0") for number in range(5)]
    assert {len(share) for share in shares} == {8}
    assert len({piece for share in shares for piece in share}) == 40


@pytest.mark.parametrize("workers", [0, 1])
def test_a_damaged_segment_ends_it_with_its_name(made, tmp_path, workers):
    out = Path(shutil.copytree(made, tmp_path / "out"))
    recording = next((out / "recordings").rglob("*.mcap"))
    commit = next(path for path in (out / "commits").rglob("*.json") if recording.name[:24] in path.name)
    place = json.loads(commit.read_text())["messages"][0]
    data = bytearray(recording.read_bytes())
    data[place[1] + place[2] // 2] ^= 1
    recording.write_bytes(data)
    dataset = lidarcodec.open_archive(out).dataset()
    with pytest.raises(SourceError, match=f"segment car-./roof/{recording.name[:24]}: "):
        list(DataLoader(dataset, batch_size=None, num_workers=workers))
    recording.unlink()
    with pytest.raises(SourceError, match="removed after the dataset was opened"):
        list(dataset)


def test_wrong_wishes_are_told(made, monkeypatch):
    archive = lidarcodec.open_archive(made)
    for wrong in ({"vehicle": "car-9"}, {"buffer": 0}, {"rank": 1}, {"rank": 2, "world": 2}, {"rank": -1, "world": 2}):
        with pytest.raises((SourceError, SettingsError)):
            archive.dataset(**wrong)
    with pytest.raises(SettingsError, match="the epoch"):
        archive.dataset().set_epoch(-1)
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "lidarcodec.archive.dataset")
    with pytest.raises(MissingExtraError, match=r"lidarcodec\[torch\]"):
        archive.dataset()


@pytest.mark.sweep
def test_the_python_of_the_guide_runs(made):
    text = (Path(__file__).parents[2] / "docs/guides/archive.md").read_text()
    names: dict = {}
    for block in re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL):
        exec(compile(block, "archive.md", "exec", dont_inherit=True), names)
    assert names["nearest"](str(made)) == []
    assert names["train"](str(made)) == FRAMES
