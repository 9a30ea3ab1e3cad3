"""What happens when two do the same, when a task fails, and when names are hostile: without codecs, in an instant."""

from __future__ import annotations

import json
from collections import Counter
from random import Random

import pytest

from lidarcodec.archive import index as index_module
from lidarcodec.archive.contents import WHOLE, Contents, commits_of
from lidarcodec.archive.driver import KILLS, TRIES, drive
from lidarcodec.archive.inputs import inputs_of
from lidarcodec.archive.names import FORMAT, Commit, commit_of, id_of, json_of
from lidarcodec.archive.objects import read_commit
from lidarcodec.archive.plan import SegmentPlan
from lidarcodec.archive.product import Product, publish
from lidarcodec.archive.query import query
from lidarcodec.archive.stores.base import Entry, check_name
from lidarcodec.archive.stores.folder import FolderStore
from lidarcodec.archive.table import COLUMNS, Tables, write_table
from lidarcodec.archive.tasks import Ended, Task
from lidarcodec.errors import SourceError

ORIGIN, SEGMENT = id_of("origin"), id_of("segment")


def product(folder, text: str) -> Product:
    """A segment whose recording is a text."""
    folder.mkdir()
    recording, table = folder / "recording.mcap", folder / "frames.parquet"
    recording.write_text(text)
    table.write_text(text)
    commit = Commit("car-7", "roof", 5, 9, ORIGIN, SEGMENT)
    names = f"car-7/roof/{SEGMENT}-{text}"
    value = {"format": FORMAT, "segment": SEGMENT, "object": f"recordings/{names}", "table": f"frames/{names}",
             "sha256": text, "bytes": len(text), "frames": 1, "packets": 1, "settings": {}, "job": "recompress",
             "bound_m": None, "error_m": 0.5, "messages": [[5, 0, 5, 7, 0, 1, 1, -1]]}  # fmt: skip
    return Product(recording, table, commit, value)


def test_who_comes_second_removes_what_it_wrote(tmp_path):
    store = FolderStore(tmp_path / "store")
    first, other = product(tmp_path / "a", "first"), product(tmp_path / "b", "other")
    assert publish(store, first)
    assert not publish(store, other)
    assert publish(store, first)  # the same bytes: nothing is removed
    assert read_commit(store, first.commit)["sha256"] == "first"
    assert {entry.name.rpartition("-")[2] for entry in store.entries("recordings/")} == {"first"}


def test_a_damaged_commit_is_an_error_that_names_it(tmp_path):
    store, commit = FolderStore(tmp_path), Commit("car-7", "roof", 5, 9, ORIGIN, SEGMENT)
    for text in (b"", b"{}", b'{"format": 99}', b"[" * 1000):
        store.delete(commit.name)
        store.create(commit.name, text)
        with pytest.raises(SourceError, match="is damaged"):
            read_commit(store, commit)


@pytest.mark.parametrize(
    ("key", "bad"),
    [
        ("frames", 10**18), ("frames", -1), ("frames", True), ("frames", "1"), ("bytes", 4), ("packets", 1.0),
        ("settings", []), ("bound_m", -1.0), ("bound_m", 1e99), ("error_m", "1"), ("error_m", True),
        ("object", "commits/car-7/roof/x"), ("object", "../x"), ("table", 5), ("sha256", None),
        ("messages", [[5, 0, 5, 7, 0, 10**18, 1, -1]]), ("messages", [[5, 0, 5, 7, 0, 1, 1]]), ("messages", 7),
        ("messages", [[5, 2, 10**15, 7, 0, 1, 1, -1]]), ("messages", [[5, 0, 1, 7, n, 20_000, 1, -1] for n in (1, 2)]),
        ("job", "compress"),
    ],
)  # fmt: skip
def test_numbers_of_a_hostile_commit_are_bounded(tmp_path, key, bad):
    made = product(tmp_path / "a", "first")
    store = FolderStore(tmp_path / "store")
    store.create(made.commit.name, json_of(made.value))
    assert read_commit(store, made.commit) == made.value
    store.delete(made.commit.name)
    store.create(made.commit.name, json_of(made.value | {key: bad}))
    with pytest.raises(SourceError, match="is damaged"):
        read_commit(store, made.commit)


def test_a_ring_of_damaged_commits_ends(tmp_path):
    store = FolderStore(tmp_path)
    for one, other in ((ORIGIN, SEGMENT), (SEGMENT, ORIGIN)):
        store.create(Commit("car-7", "roof", 5, 9, one, other).name, b"{}")
        store.create(f"recordings/car-7/roof/{one}-x.mcap", b"")
    assert list(SegmentPlan("recompress", store, store, lambda _: {}, clears=True).tasks()) == []


@pytest.mark.sweep
def test_tables_are_joined_as_they_grow_and_each_row_is_read_once(tmp_path, monkeypatch):
    """Whatever is joined, and when: a segment's rows are in one of the tables that a query reads."""
    monkeypatch.setattr(index_module, "FAN_IN", 3)
    store, random = FolderStore(tmp_path / "store"), Random(33)
    commits: list[Commit] = []
    for step in range(12):
        origin = random.choice(commits).segment if commits and random.random() < 0.2 else id_of("origin", step)
        segment = id_of("segment", step)
        commit = Commit("car-7", "roof", step, step, origin, segment)
        path = tmp_path / "part.parquet"
        write_table([dict.fromkeys(COLUMNS) | {"segment": segment, "stamp_ns": step, "vehicle": "car-7"}], path)
        name = f"frames/car-7/roof/{segment}-{'0' * 16}.parquet"
        store.create(name, path)
        store.create(commit.name, b"{}")
        commits.append(commit)
        if step % 4 != 3:
            continue
        index_module.index(store)
        replaced = {one.origin for one in commits}
        expected = sorted(one.first_ns for one in commits if one.segment not in replaced)
        assert query(store, "select stamp_ns from frames order by all")[1] == [(stamp,) for stamp in expected]
    assert len(index_module.tables_to_read(store).names) <= 8


def test_a_query_looks_again_when_tables_were_joined_meanwhile(tmp_path, monkeypatch):
    store = FolderStore(tmp_path)
    lists = iter([Tables(["frames/gone.parquet"]), Tables([])])
    monkeypatch.setattr("lidarcodec.archive.query.tables_to_read", lambda _, **more: next(lists))
    assert query(store, "select count(*) from frames")[1] == [(0,)]


def test_a_replaced_segment_is_not_visible(tmp_path):
    store = FolderStore(tmp_path)
    new = Commit("car-7", "roof", 5, 9, SEGMENT, id_of("new"))
    for commit in (Commit("car-7", "roof", 5, 9, ORIGIN, SEGMENT), new):
        store.create(commit.name, b"{}")
        assert commit_of(commit.name) == commit
    assert commits_of(store) == [new]
    assert commits_of(store, "car-7", "roof", (10, 20)) == []


def test_of_two_that_replace_a_segment_one_is_visible(tmp_path):
    """Two runs with different settings, or a late task of an earlier one."""
    store = FolderStore(tmp_path)
    first = Commit("car-7", "roof", 5, 9, ORIGIN, SEGMENT)
    twins = [Commit("car-7", "roof", 5, 9, SEGMENT, id_of("twin", number)) for number in range(2)]
    later = [Commit("car-7", "roof", 5, 9, twin.segment, id_of("later", twin.segment)) for twin in twins]
    winner = min(twins, key=lambda one: one.segment)
    for commit in (first, *twins):
        store.create(commit.name, b"{}")
        store.create(f"recordings/car-7/roof/{commit.segment}-{'0' * 16}.mcap", b"")
    assert commits_of(store) == [winner]
    (task,) = SegmentPlan("recompress", store, store, lambda _: {}, clears=True).tasks()
    assert {Commit(*one) for one in task.value["older"]} == {first, *twins} - {winner}
    for commit in later:
        store.create(commit.name, b"{}")
    assert commits_of(store) == [later[twins.index(winner)]]
    parts = [Commit("car-7", "roof", at, at, id_of("input"), id_of("part", at)) for at in (20, 30)]
    for commit in parts:
        store.create(commit.name, b"{}")
    assert commits_of(store, between=(20, 40)) == parts  # of one input: other ranges


class Scripted:
    """An engine whose tasks end as a script says."""

    slots = 1

    def __init__(self, how: str) -> None:
        self._how, self._tasks, self.counts = how, [], Counter()

    def submit(self, task: Task) -> None:
        self._tasks.append(task)

    def ended(self, wait_s: float) -> list[Ended]:
        task = self._tasks.pop()
        self.counts[task.label] += 1
        return [Ended(task, "done" if task.label == "good" else self._how, why="because")]

    def close(self) -> None:
        pass


class TwoTasks:
    """A plan of a good task and a bad one."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def tasks(self):
        for label in ("bad", "good"):
            yield Task("cut", f"{id_of(label)}-{WHOLE}", label, "", "")

    def after(self, ended):
        return iter(())


@pytest.mark.parametrize(
    ("how", "tries", "aside"), [("refused", 1, True), ("failed", TRIES, True), ("late", TRIES, True),
                                ("killed", KILLS, True), ("store", TRIES, False)],
)  # fmt: skip
def test_a_task_that_keeps_failing_stops_nothing(tmp_path, how, tries, aside):
    store, engine = FolderStore(tmp_path), Scripted(how)
    outcome = drive(TwoTasks(), engine, store, pause_s=0.0)
    assert engine.counts == {"bad": tries, "good": 1}
    assert outcome.counts["cut"] == 1
    assert (outcome.aside if aside else outcome.left) == [("bad", "because")]
    assert bool(Contents.of(store).aside) == aside
    if aside:
        (path,) = (tmp_path / "aside").iterdir()
        assert json.loads(path.read_text()) == {"what": "bad", "why": "because"}


@pytest.mark.parametrize("name", ["../a", "a/../../b", "/etc/passwd", "~/a", "a\\..\\b", "a//b", "", "a/./b", "a\nb"])
def test_names_that_leave_their_folder_are_refused(tmp_path, name):
    with pytest.raises(SourceError):
        check_name(name)
    with pytest.raises(SourceError):
        FolderStore(tmp_path).create(name, b"")
    found = list(inputs_of([Entry(f"{name}.pcap", 1, "")]))
    assert all(one.refused for one in found) or name in ("", "a/./b")


def test_a_listing_is_in_the_order_of_object_stores(tmp_path):
    store = FolderStore(tmp_path)
    names = ["a-b/x", "a/b/x", "a/x", "a0", "b"]
    for name in names:
        store.create(name, b"")
    assert [entry.name for entry in store.entries()] == sorted(names)
    for after in names:
        assert [entry.name for entry in store.entries(after=after)] == [name for name in sorted(names) if name > after]


def test_a_small_object_is_read_no_further_than_its_limit(tmp_path):
    """A commit of many gigabytes would take all memory before it is refused."""
    read = []

    class Counting(FolderStore):
        def read(self, name, start=0, length=None):
            read.append(data := super().read(name, start, length))
            return data

    store, commit = Counting(tmp_path), Commit("car-7", "roof", 5, 9, ORIGIN, SEGMENT)
    (path := tmp_path / commit.name).parent.mkdir(parents=True)
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(SourceError, match="more than 16,777,216 bytes"):
        read_commit(store, commit)
    assert sum(map(len, read)) == (16 << 20) + 1


def test_a_full_disk_is_an_error_of_the_store(tmp_path, monkeypatch):
    """It may have room later: what a segment meets there is no reason to set it aside."""
    store = FolderStore(tmp_path)

    def full(*_, **__):
        raise SourceError("cannot write: No space left on device")

    monkeypatch.setattr("lidarcodec.archive.stores.folder.whole", full)
    with pytest.raises(OSError, match="No space left"):
        store.create("a", b"1")
    with pytest.raises(OSError, match="No space left"):
        store.upload("a", [b"1"])


@pytest.mark.parametrize("reads", [0, 1])
def test_a_store_that_fails_while_tables_are_read_is_an_error_of_the_store(tmp_path, reads):
    """DuckDB tells such an error as a text of its own."""

    class Failing(FolderStore):
        def file(self, name):
            return None

        def read(self, name, start=0, length=None):
            if name.endswith(".parquet"):
                raise OSError("the connection was cut")
            return super().read(name, start, length)

    store = Failing(tmp_path / "store")
    segment = id_of("segment")
    write_table([dict.fromkeys(COLUMNS) | {"segment": segment}], tmp_path / "part.parquet")
    store.create(f"frames/car-7/roof/{segment}-{'0' * 16}.parquet", tmp_path / "part.parquet")
    store.create(Commit("car-7", "roof", 1, 1, ORIGIN, segment).name, b"{}")
    with pytest.raises(OSError, match="the connection was cut"):
        query(store, "select * from frames") if reads else index_module._join(store, _the_one_group(store))


def _the_one_group(store):
    tables = index_module.tables_to_read(store)
    return index_module._Group(tables, [id_of("segment")])
