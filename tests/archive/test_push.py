"""Recordings of a vehicle reach a store: whole, once, at a limited rate, and are deleted only when it has them."""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path

import pytest

from lidarcodec.archive.push import Rate, push
from lidarcodec.archive.stores.folder import FolderStore
from lidarcodec.errors import SourceError
from lidarcodec.packet import Packet
from lidarcodec.recording import RecordingWriter
from tests.command_line import run_here


@pytest.fixture
def folder(tmp_path) -> Path:
    """Two recordings of car-7/roof, and a file that is none."""
    found = tmp_path / "recordings"
    found.mkdir()
    for number in range(2):
        with (found / f"car-7_roof_{number}.mcap").open("wb") as file, RecordingWriter(file, "car-7", "roof") as writer:
            writer.write_packets([Packet(bytes([number]) * 1206, number)])
    (found / "notes.mcap").write_bytes(b"no recording")
    return found


def test_a_second_push_uploads_nothing(folder, tmp_path, caplog):
    first = run_here("archive", "push", str(folder), str(tmp_path / "store"), "--json")
    assert first.returncode == 1
    assert f"{folder / 'notes.mcap'} is not a recording" in caplog.text
    told = json.loads(first.stdout)
    assert (told["uploaded"], told["already_there"], told["unreadable"], told["deleted"]) == (2, 0, 1, 0)
    (folder / "notes.mcap").unlink()
    second = run_here("archive", "push", str(folder), str(tmp_path / "store"), "--json")
    assert second.returncode == 0
    again = json.loads(second.stdout)
    assert (again["uploaded"], again["already_there"]) == (0, 2)
    stored = tmp_path / "store" / "car-7" / "roof" / "car-7_roof_1.mcap"
    assert stored.read_bytes() == (folder / "car-7_roof_1.mcap").read_bytes()


def test_only_what_the_store_gives_back_is_deleted(folder, tmp_path):
    class Forgetful(FolderStore):
        """Gives back other bytes than it was given."""

        def read(self, name, start=0, length=None):
            data = super().read(name, start, length)
            return data if name.endswith(".json") else b"?" + data[1:]

    with pytest.raises(SourceError, match="was kept"):
        push(folder, Forgetful(tmp_path / "bad"), rate=Rate(None), delete=True)
    assert len(list(folder.iterdir())) == 3
    counts = push(folder, FolderStore(tmp_path / "good"), rate=Rate(None), delete=True)
    assert counts["deleted"] == 2
    assert [path.name for path in folder.iterdir()] == ["notes.mcap"]


def test_two_recordings_of_one_name_are_both_kept(folder, tmp_path, caplog):
    """A clock without a battery gives the same name after each boot."""
    (folder / "notes.mcap").unlink()
    first, store = (folder / "car-7_roof_0.mcap").read_bytes(), FolderStore(tmp_path / "store")
    foreign = tmp_path / "store/car-7/roof/car-7_roof_1.mcap"
    foreign.parent.mkdir(parents=True)
    foreign.write_bytes(b"copied by hand, without a note")
    second = (folder / "car-7_roof_1.mcap").read_bytes()
    assert push(folder, store, rate=Rate(None), delete=True)["deleted"] == 2
    assert foreign.read_bytes() == b"copied by hand, without a note"
    for _ in range(2):
        (folder / "car-7_roof_0.mcap").write_bytes(second)
        counts = push(folder, store, rate=Rate(None), delete=True)
    assert (counts["already_there"], counts["deleted"]) == (1, 1)
    stored = [path.read_bytes() for path in (tmp_path / "store").rglob("*.mcap")]
    assert sorted(map(len, stored)) == sorted(map(len, [foreign.read_bytes(), first, second, second]))
    assert {first, second} < set(stored)
    assert "the store already has another recording named car-7/roof/car-7_roof_0.mcap" in caplog.text


def test_a_recording_that_was_copied_by_hand_is_there_already(folder, tmp_path):
    stored = tmp_path / "store/car-7/roof/car-7_roof_1.mcap"
    stored.parent.mkdir(parents=True)
    stored.write_bytes((folder / "car-7_roof_1.mcap").read_bytes())
    counts = push(folder, FolderStore(tmp_path / "store"), rate=Rate(None))
    assert (counts["uploaded"], counts["already_there"]) == (1, 1)


def test_an_upload_that_was_cut_is_done_again_under_its_name(folder, tmp_path):
    class Cut(FolderStore):
        def upload(self, name, chunks):
            raise OSError("the connection was cut")

    with pytest.raises(OSError, match="was cut"):
        push(folder, Cut(tmp_path / "store"), rate=Rate(None))
    assert push(folder, FolderStore(tmp_path / "store"), rate=Rate(None))["uploaded"] == 2
    assert {path.name for path in (tmp_path / "store").rglob("*.mcap")} == {f"car-7_roof_{n}.mcap" for n in (0, 1)}


def test_a_recording_that_is_being_written_waits(folder, tmp_path):
    with (folder / "car-7_roof_1.mcap").open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        counts = push(folder, FolderStore(tmp_path / "store"), rate=Rate(None))
    assert (counts["uploaded"], counts["still_written"]) == (1, 1)


def test_a_recording_that_is_removed_meanwhile_ends_nothing(folder, tmp_path, monkeypatch):
    """The recorder removes the oldest files of a full folder whenever it likes."""
    whole, first = Path.glob, folder / "car-7_roof_0.mcap"

    def glob(self, pattern):
        yield from [*whole(self, pattern), folder / "gone.mcap"]

    monkeypatch.setattr(Path, "glob", glob)
    counts = push(folder, FolderStore(tmp_path / "a"), rate=Rate(None), stopped=lambda: first.unlink(missing_ok=True))
    assert (counts["uploaded"], counts["gone"]) == (1, 1)


def test_a_pipe_and_a_changed_recording_are_kept(folder, tmp_path):
    os.mkfifo(folder / "pipe.mcap")
    path = folder / "car-7_roof_1.mcap"

    class Slow(FolderStore):
        def read(self, name, start=0, length=None):
            if name.endswith("_1.mcap"):
                path.touch()
            return super().read(name, start, length)

    with pytest.raises(SourceError, match="changed while it was uploaded"):
        push(folder, Slow(tmp_path / "store"), rate=Rate(None), delete=True)
    assert path.exists()


def test_recordings_of_a_server_go_the_same_way_and_stay(folder, tmp_path):
    (shelf := folder / "20261121T101500Z-3fa2c9").mkdir()
    (folder / "car-7_roof_1.mcap").rename(shelf / "car-7_roof_1.mcap")
    counts = push(folder, FolderStore(tmp_path / "store"), rate=Rate(None), delete=True)
    assert (counts["uploaded"], counts["deleted"]) == (2, 1)
    assert (tmp_path / "store/car-7/roof/20261121T101500Z-3fa2c9-car-7_roof_1.mcap").exists()
    assert (shelf / "car-7_roof_1.mcap").exists()
    shelf.rename(shelf.with_name("an\nodd name"))
    counts = push(folder, FolderStore(tmp_path / "store"), rate=Rate(None))
    assert (counts["uploaded"], counts["unreadable"]) == (0, 2)


def test_a_rate_is_kept():
    now, slept = [0.0], []

    def pause(seconds):
        slept.append(seconds)
        now[0] += seconds

    rate = Rate(1000.0, lambda: now[0], pause)
    for _ in range(5):
        rate.spend(500)
    assert now[0] == pytest.approx(2.0)
    assert len(slept) == 4
