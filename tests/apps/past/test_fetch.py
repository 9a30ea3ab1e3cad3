"""A clip is fetched exactly, whatever is cut in between, and nothing that a vehicle says is trusted."""

from __future__ import annotations

import json
import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from lidarcodec.apps.once import Once
from lidarcodec.apps.past import fetch
from lidarcodec.apps.past.answers import HEAD, PART, Answers, Link
from lidarcodec.apps.past.clip import write_clip
from lidarcodec.apps.past.fetch import CancelledError, Fetch
from lidarcodec.apps.past.keeper import Keep, Keeper
from lidarcodec.apps.past.kept import Kept
from lidarcodec.apps.past.plan import Clip, Plan
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files.piece_store import PieceStore
from lidarcodec.transport import asking, part_size
from lidarcodec.transport.base import Closeable
from lidarcodec.transport.memory import MemoryNetwork, MemoryTransport
from tests.apps.past.kept_drive import FRAME_NS, KEYS, SMALL, at, feed, frames, kept, packets, ring
from tests.packets import packets_in
from tests.sweeps import sampled

CLIP = Clip(KEYS, at(5), at(25))


class Vehicle:
    """Answers about a folder. It may be taken off the network, and it counts the questions that it was asked."""

    def __init__(self, network: MemoryNetwork, folder: Path) -> None:
        self.kept = Kept(folder, KEYS, SMALL)
        self._transport = network.transport()
        self._declared: list[Closeable] = []
        self.asked: Counter[str] = Counter()
        self.after: Callable[[Counter[str]], None] = lambda asked: None
        self.spoils: Callable[[bytes], bytes] = lambda answer: answer
        self.come()

    def come(self, link: Link | None = None) -> None:
        told = Answers(self.kept, KEYS, lambda: link, lambda: 0.0, Once(logging.getLogger(__name__)))

        def answer(data: bytes) -> bytes:
            self.asked[json.loads(data)["ask"]] += 1
            given = told._answer(data)
            self.after(self.asked)
            return self.spoils(given)

        self._declared = [self._transport.answer(KEYS.past, answer)]

    def go(self) -> None:
        for one in self._declared:
            one.close()


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which 30 frames were kept."""
    folder = tmp_path_factory.mktemp("drive")
    kept(folder, 30)
    return folder


@pytest.fixture
def network() -> MemoryNetwork:
    return MemoryNetwork()


@pytest.fixture
def vehicle(network: MemoryNetwork, drive: Path) -> Vehicle:
    return Vehicle(network, drive)


@pytest.fixture
def near(network: MemoryNetwork) -> Iterator[MemoryTransport]:
    with network.transport() as transport:
        yield transport


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asking, "ANSWER_S", 0.3)
    monkeypatch.setattr(asking, "FIRST_WAIT_S", 0.02)
    monkeypatch.setattr(fetch, "FRESH_S", 0.05)
    monkeypatch.setattr(part_size, "MIN_PART", 50_000)


def fetching(folder: Path, near: MemoryTransport, clip: Clip = CLIP, patience_s: float = 20.0) -> Fetch:
    return Fetch(clip, PieceStore(folder), folder / "plan.json", lambda: near, patience_s)


def check_exact(done: Fetch, folder: Path) -> None:
    """The clip has the packets of the drive, from its piece before the begin to its piece behind the end."""
    clip = folder / "clip.mcap"
    write_clip(done.plan, PieceStore(folder), clip)
    found = packets_in(str(clip))
    want = [packet for packet in packets(30) if found[0].stamp_ns <= packet.stamp_ns <= found[-1].stamp_ns]
    assert [packet.payload for packet in found] == [packet.payload for packet in want]
    assert found[0].stamp_ns <= done.clip.from_ns
    assert found[-1].stamp_ns + FRAME_NS >= done.clip.to_ns


class Gap:
    """A link with room for `size` bytes at each second look, and for none in between."""

    def __init__(self, size: int) -> None:
        self.busy, self.looks, self._size = True, 0, size

    def room(self, most: int, least: int) -> tuple[float, int] | None:
        self.looks += 1
        return (0.0, min(self._size, most)) if self.looks % 2 else (0.001, 0)


@pytest.mark.parametrize("size", sampled([1, 12_345], [12_345]))
def test_parts_are_as_large_as_there_is_room_between_live_messages(
    tmp_path: Path, vehicle: Vehicle, near: MemoryTransport, size: int
) -> None:
    vehicle.go()
    link = Gap(size)
    vehicle.come(link)
    one = fetching(tmp_path, near)
    if size == 1:
        vehicle.after = lambda asked: one.cancel() if asked["part"] == 20 else None
        with pytest.raises(CancelledError):
            one.run()
        assert one.state()["bytes_done"] == 20
    else:
        one.run()
        check_exact(one, tmp_path)
        assert vehicle.asked["part"] >= sum(piece.size for piece in one.plan.there) / size


def test_a_clip_is_fetched_exactly(tmp_path: Path, vehicle: Vehicle, near: MemoryTransport) -> None:
    done = fetching(tmp_path, near)
    done.run()
    check_exact(done, tmp_path)
    state = done.state()
    assert (state["pieces"], state["bytes"], state["gaps"]) == (state["pieces_done"], state["bytes_done"], [])
    assert state["bytes_received"] <= 1.01 * state["bytes"]


def test_after_any_cut_it_goes_on_and_nothing_is_fetched_twice(
    tmp_path: Path, vehicle: Vehicle, near: MemoryTransport
) -> None:
    """The receiver is stopped again and again; the vehicle goes away and comes back."""
    received, cuts = 0, 0
    while True:
        one = fetching(tmp_path, near)
        limit = vehicle.asked.total() + 3

        def cut(asked: Counter[str], one: Fetch = one, limit: int = limit) -> None:
            if asked.total() == limit:
                one.cancel()
                vehicle.go()
                threading.Timer(0.1, vehicle.come).start()

        vehicle.after = cut
        try:
            one.run()
            break
        except CancelledError:
            cuts += 1
        finally:
            received += one.received
    assert cuts > 3
    check_exact(one, tmp_path)
    assert received <= 1.01 * one.state()["bytes"] + 50_000 * cuts


def test_what_another_clip_brought_is_not_fetched_again(
    tmp_path: Path, vehicle: Vehicle, near: MemoryTransport
) -> None:
    fetching(tmp_path, near, Clip(KEYS, at(12), at(15))).run()
    longer = Fetch(CLIP, PieceStore(tmp_path), tmp_path / "other.json", lambda: near, 20.0)
    longer.run()
    assert 0 < longer.received < 0.7 * longer.state()["bytes"]
    check_exact(longer, tmp_path)


def test_wrong_bytes_on_disk_and_from_the_network_are_found_by_their_hash(
    tmp_path: Path, vehicle: Vehicle, near: MemoryTransport
) -> None:
    first = fetching(tmp_path, near)
    first._list()
    piece = first.plan.pieces[0]
    first._store.add(piece.name, 0, bytes(60_000))  # as after a power failure
    first.run()
    check_exact(first, tmp_path)
    vehicle.spoils = lambda answer: answer[:-1] + bytes([answer[-1] ^ 1]) if answer[0] == PART else answer
    second = fetching(tmp_path / "second", near)
    with pytest.raises(SourceError, match="arrived damaged 3 times"):
        second.run()
    assert not list((tmp_path / "second").glob("*.piece"))


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"\x00",
        b"no json",
        b"[]",
        b'{"pieces": 3}',
        b'{"pieces": [{"name": "../../etc/passwd", "begin_ns": 1, "end_ns": 2, "size": 3, "frames": 4}]}',
        b'{"pieces": [{"name": "%s", "begin_ns": 1, "end_ns": 2, "size": 99999999999, "frames": 4}]}' % (b"a" * 64),
        b'{"pieces": [{"name": "%s", "begin_ns": -1, "end_ns": 2, "size": 9, "frames": 4}]}' % (b"a" * 64),
        b'{"pieces": [{"name": "%s", "begin_ns": 9, "end_ns": 2, "size": 9, "frames": 4}]}' % (b"a" * 64),
        b'{"error": "no"}',
        HEAD.pack(PART, 0),
    ],
    ids=range(11),
)
def test_answers_that_make_no_sense_end_it(
    tmp_path: Path, network: MemoryNetwork, near: MemoryTransport, answer: bytes
) -> None:
    network.transport().answer(KEYS.past, lambda data: answer)
    with pytest.raises(SourceError):
        fetching(tmp_path, near, patience_s=0.5).run()
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".piece", ".part")]


def test_a_vehicle_that_does_not_answer_is_given_up_after_a_while(tmp_path: Path, near: MemoryTransport) -> None:
    with pytest.raises(SourceError, match=r"did not answer for 0\.2 s"):
        fetching(tmp_path, near, patience_s=0.2).run()


@pytest.mark.parametrize("grows", [False, True], ids=["the same", "a newest one that creeps"])
def test_a_list_that_never_ends_ends_the_fetch(
    tmp_path: Path, network: MemoryNetwork, near: MemoryTransport, monkeypatch: pytest.MonkeyPatch, grows: bool
) -> None:
    """A vehicle could keep one of the places of a server for good."""
    monkeypatch.setattr(fetch, "STUCK_S", 0.2)
    monkeypatch.setattr(Fetch, "_pause", lambda one, seconds: one._check_going())
    piece = {"name": "a" * 64, "begin_ns": at(6), "end_ns": at(7), "size": 9, "frames": 1}
    asked = count()

    def answer(data: bytes) -> bytes:
        return json.dumps({"pieces": [piece], "more": not grows, "until_ns": next(asked)}).encode()

    network.transport().answer(KEYS.past, answer)
    with pytest.raises(SourceError, match=r"has no end|nothing new for too long|refuses"):
        fetching(tmp_path, near, patience_s=0.1).run()


def test_a_piece_that_is_listed_twice_is_in_the_clip_once() -> None:
    """A vehicle could fill a disk with a piece that it sent once."""
    plan = Plan(CLIP)
    piece = {"name": "a" * 64, "begin_ns": at(6), "end_ns": at(7), "size": 9, "frames": 1}
    assert (plan.add([piece] * 3), plan.add([piece]), len(plan.pieces)) == (1, 0, 1)


def test_parts_of_a_byte_end_it(
    tmp_path: Path, vehicle: Vehicle, near: MemoryTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fetch, "STUCK_S", 0.2)
    vehicle.spoils = lambda answer: answer[: HEAD.size + 1] if answer[0] == PART else answer
    with pytest.raises(SourceError, match="nothing new for too long"):
        fetching(tmp_path, near, patience_s=0.2).run()


def test_a_flood_of_questions_about_pieces_that_nobody_listed_reads_few_files(
    tmp_path: Path, vehicle: Vehicle, near: MemoryTransport
) -> None:
    """Each of them had all files of that time read: six at once took a processor from the live stream."""

    def asked_for(name: str) -> bytes:
        question = {"ask": "part", "piece": name, "at_ns": at(8), "offset": 0, "bytes": 100}
        return near.ask(KEYS.past, json.dumps(question).encode()) or b""

    told = [json.loads(asked_for(f"{number:064x}")) for number in range(60)]
    refused = [one["retry_s"] for one in told if "requested too often" in one["error"]]
    assert len(refused) > 20
    assert all(0.0 < retry_s < 5.0 for retry_s in refused)
    listed, _ = vehicle.kept.pieces(CLIP.from_ns, CLIP.to_ns)
    assert all(asked_for(piece.name)[:1] == bytes([PART]) for piece in listed * 3)


def test_a_fetch_waits_where_a_part_is_refused_for_a_while(
    tmp_path: Path, vehicle: Vehicle, near: MemoryTransport
) -> None:
    refusals = [b'{"error": "too often", "retry_s": 0.01}'] * 3
    vehicle.spoils = lambda answer: refusals.pop() if refusals and answer[0] == PART else answer
    assert len(fetching(tmp_path, near).run().there) == 3
    assert not refusals


def test_messages_of_another_time_than_listed_are_no_clip(
    tmp_path: Path, vehicle: Vehicle, near: MemoryTransport
) -> None:
    plan = fetching(tmp_path, near).run()
    plan.pieces = [piece._replace(begin_ns=at(1000), end_ns=at(1010)) for piece in plan.pieces]
    with pytest.raises(SourceError, match="messages of another time"):
        write_clip(plan, PieceStore(tmp_path), tmp_path / "clip.mcap")


def test_a_clip_counts_the_frames_that_it_holds_whatever_the_vehicle_had_listed(
    tmp_path: Path, vehicle: Vehicle, near: MemoryTransport
) -> None:
    done = fetching(tmp_path, near)
    plan = done.run()
    listed = sum(piece.frames for piece in plan.there)
    plan.pieces = [piece._replace(frames=piece.frames + 5) for piece in plan.pieces]
    assert write_clip(plan, PieceStore(tmp_path), tmp_path / "clip.mcap").frames == listed


def test_frames_that_the_vehicle_dropped_are_missed_one_by_one(
    tmp_path: Path, network: MemoryNetwork, near: MemoryTransport
) -> None:
    """A hole of a few frames is shorter than any gap, and a recording without it looks whole."""
    folder = tmp_path / "ring"
    keeper = Keeper(Keep(folder, SMALL), KEYS)
    keeper.start()
    feed(keeper, [frame for frame in frames(20) if frame.index not in (7, 8, 12)])
    keeper.close()
    Vehicle(network, folder)
    done = fetching(tmp_path, near, Clip(KEYS, at(0), at(20)))
    written = write_clip(done.run(), PieceStore(tmp_path), tmp_path / "clip.mcap")
    assert (written.frames, written.missing, done.plan.gaps()) == (17, 3, [])
    assert [hole.frames for hole in written.holes] == [2, 1]
    assert [round((hole.to_ns - hole.from_ns) / FRAME_NS) for hole in written.holes] == [3, 2]


def test_what_was_overwritten_meanwhile_is_a_gap(tmp_path: Path, network: MemoryNetwork, near: MemoryTransport) -> None:
    folder = tmp_path / "ring"
    ring(folder, 0, 60)
    vehicle = Vehicle(network, folder)
    one = fetching(tmp_path, near, Clip(KEYS, at(0), at(60)))
    one._list()
    ring(folder, 60, 110)
    one.run()
    assert one.plan.gone
    (gap,) = one.plan.gaps()
    assert gap[0] == at(0)
    assert at(20) < gap[1] < at(60)
    assert vehicle.kept.spans()[0][0] <= gap[1]


def test_questions_that_make_no_sense_get_an_error(vehicle: Vehicle, near: MemoryTransport) -> None:
    for question in (
        b"{",
        b'{"ask": "all"}',
        b'{"ask": "pieces"}',
        b'{"ask": "pieces", "from": "yesterday", "to": 5}',
        b'{"ask": "part"}',
        b'{"ask": "part", "piece": "%s", "at_ns": %d, "offset": 0, "bytes": 5}' % (b"a" * 64, at(1)),
        b'{"ask": "part", "piece": "../secret", "at_ns": %d, "offset": -1, "bytes": 5}' % at(1),
    ):
        told: dict[str, Any] = json.loads(Answers(vehicle.kept, KEYS, lambda: None, lambda: 0.0,
                                                  Once(logging.getLogger(__name__)))._answer(question))  # fmt: skip
        assert "error" in told, question


@pytest.mark.parametrize("span", [(5, 5), (6, 5), (0, 3601 * 10**9), (-1, 5)])
def test_spans_that_are_none(span: tuple[int, int]) -> None:
    with pytest.raises(SettingsError):
        Clip(KEYS, *span)
