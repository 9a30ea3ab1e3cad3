"""Copies of segments at a server: bounded, removed after a kill, and errors of the disk here are told as such."""

from __future__ import annotations

import asyncio
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import namedtuple
from pathlib import Path

import pytest

pytest.importorskip("duckdb", reason="needs the extra archive")

from lidarcodec.archive.archive import Archive
from lidarcodec_server.archived import archived as module
from lidarcodec_server.archived.archived import Archived
from lidarcodec_server.archived.copies import PREFIX, Copies
from lidarcodec_server.archived.errors import BusyArchiveError, FullError
from lidarcodec_server.archived.finding import Wanted, segment_of
from tests.command_line import run_here
from tests.drives import simulated

KILLED = """
import sys
from pathlib import Path
from lidarcodec.archive.archive import Archive
from lidarcodec_server.archived.copies import Copies
copies = Copies(Archive(sys.argv[1]))
copies.path("a").write_bytes(bytes(1000))
print(copies.path("a"), flush=True)
sys.stdin.read()
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory) -> Archive:
    """An archive of car-7/roof: two segments."""
    folder = tmp_path_factory.mktemp("archive")
    roof = folder / "in" / "car-7" / "roof"
    roof.mkdir(parents=True)
    simulated("sim:city?sensor=vlp16&frames=12", roof / "drive.pcap")
    done = run_here("archive", "run", str(folder / "in"), str(folder / "out"), "--workers", "here", "--seconds", "1")
    assert done.returncode == 0, done.stderr
    return Archive(folder / "out")


@pytest.fixture
def segments(archive) -> list[str]:
    return [row[0] for row in archive.query("select distinct segment from frames order by 1")[1]]


@pytest.fixture(autouse=True)
def _temporary(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)


@pytest.mark.sweep
def test_copies_of_a_killed_server_are_removed_by_the_next_one_and_those_of_one_that_runs_stay(archive, tmp_path):
    words = [sys.executable, "-c", KILLED, archive.store.url]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        copy = Path(server.stdout.readline().strip())
        beside = Copies(archive)
        assert copy.exists()
        server.send_signal(signal.SIGKILL)
        server.wait()
    assert copy.exists()
    after = Copies(archive)
    assert not copy.parent.exists()
    assert len(list(tmp_path.glob(f"{PREFIX}*"))) == 2
    for one in (beside, after, after):
        one.close()
    assert not list(tmp_path.glob(f"{PREFIX}*"))


def test_a_running_copy_keeps_the_disk_that_it_reserved(archive, segments, monkeypatch):
    one, other = segments
    sizes = {name: segment_of(archive, name, lambda: False).value["bytes"] for name in segments}
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(0, 0, sum(sizes.values()) - 1))
    copies = Copies(archive, min_free_bytes=0)
    try:
        copies._make_room(one, sizes[one])
        with pytest.raises(FullError):
            copies.make(other, threading.Event())
        copies._unwritten.clear()
        copies.make(other, threading.Event())
    finally:
        copies.close()


async def test_a_full_or_failed_disk_of_the_server_is_no_archive_that_is_away(archive, segments, caplog):
    copies = Copies(archive, min_free_bytes=0)
    archived = Archived(archive, copies)
    try:
        copies.path(segments[0]).with_suffix(".part").symlink_to("/dev/full")
        with pytest.raises(FullError, match="the disk of the server is full"):
            await archived.borrow(segments[0])
        assert "No space left" in caplog.text
        assert not copies._sizes
        shutil.rmtree(copies.path(segments[0]).parent)
        with pytest.raises(FullError, match="the disk of the server failed"):
            await archived.borrow(segments[0])
    finally:
        archived.close()


async def test_a_copy_that_someone_removed_is_made_again(archive, segments):
    archived = Archived(archive)
    try:
        path, give_back = await archived.borrow(segments[0])
        give_back()
        path.unlink()
        path, give_back = await archived.borrow(segments[0])
        give_back()
        assert path.exists()
    finally:
        archived.close()


async def test_a_segment_is_looked_for_once_and_the_search_can_be_ended(archive, segments, monkeypatch):
    with pytest.raises(TimeoutError):
        segment_of(archive, segments[0], lambda: True)
    archived = Archived(archive)
    listings = []
    entries = archive.store.entries
    monkeypatch.setattr(archive.store, "entries", lambda *words: listings.append(words) or entries(*words))
    try:
        known = await archived.known(segments[0])
        assert known.commit.sensor == "roof"
        (await archived.borrow(segments[0], known))[1]()
        assert listings == [("commits/",)]
    finally:
        archived.close()


async def test_one_client_leaves_searches_and_copies_to_others(archive, segments, monkeypatch):
    """A viewer that asked all the time, or began downloads and left them, took all places of operators."""
    archived, go = Archived(archive), threading.Event()
    monkeypatch.setattr(module, "find", lambda *words: go.wait(20))
    monkeypatch.setattr(archived._copies, "make", lambda *words: go.wait(20))

    async def refused(work):
        try:
            await asyncio.wait_for(work, 0.2)
        except BusyArchiveError:
            return True
        except TimeoutError:  # it waits, and goes on when its client has gone
            return False

    try:
        searches = [await refused(archived.find(Wanted(), "anna")) for _ in range(6)]
        copies = [await refused(archived.borrow(f"{number:024x}", None, "anna")) for number in range(6)]
        assert searches == copies == [False] * 4 + [True] * 2
        assert not await refused(archived.find(Wanted(), "olga"))
        assert not await refused(archived.borrow(segments[0], None, "olga"))
        go.set()
        await until_none(archived)
        assert not await refused(archived.find(Wanted(), "anna"))
    finally:
        go.set()
        archived.close()


async def until_none(archived):
    end = time.monotonic() + 20
    while (archived._looking or archived._copying) and time.monotonic() < end:
        await asyncio.sleep(0.01)
    assert not archived._looking
    assert not archived._copying
