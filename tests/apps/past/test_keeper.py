"""The ring of a vehicle: exact packets, bounded, never in the way of a frame, and readable after a kill at any byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from lidarcodec.apps.past import keeper as module
from lidarcodec.apps.past.keeper import WAITING, Keep, Keeper, bytes_of, check_apart
from lidarcodec.apps.past.kept import Kept
from lidarcodec.apps.recorder import Record
from lidarcodec.commands.publish.command import not_kept
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.recording.marks import MAX_MARKS, MAX_TEXT, Mark, Marks
from lidarcodec.recording.pieces import pieces_in, read_piece
from lidarcodec.recording.recorded_files import recorded_files
from tests.apps.past.kept_drive import KEYS, SMALL, at, big, feed, frames, kept, packets, ring
from tests.packets import payloads_in
from tests.recording.test_recording import message
from tests.transport.test_contract import eventually

HOUR_NS = 3600 * 10**9


def files(folder: Path) -> list[Path]:
    return recorded_files(folder, KEYS.vehicle, KEYS.sensor)


def payloads(paths: list[Path]) -> list[bytes]:
    found = []
    for path in paths:
        found += payloads_in(path)
    return found


def test_the_packets_come_back_byte_for_byte_and_the_state_says_what_is_there(tmp_path: Path) -> None:
    keeper = kept(tmp_path, 25)
    assert payloads(files(tmp_path)) == [packet.payload for packet in packets(25)]
    keeper.kept.look()
    state = keeper.state()
    assert (state["counts"]["frames"], state["stopped"], state["from_ns"], state["to_ns"]) == (25, None, at(0), at(24))
    assert state["bytes"] == sum(path.stat().st_size for path in files(tmp_path)) > 0


def test_the_oldest_files_go_first_and_the_ring_never_exceeds_its_size(tmp_path: Path) -> None:
    keeper = Keeper(Keep(tmp_path, SMALL), KEYS)
    for number in range(200):
        assert keeper._files.write(big(number))
        assert number % 10 or sum(path.stat().st_size for path in tmp_path.iterdir()) <= SMALL
    keeper._files.close()
    assert keeper.state()["counts"]["deleted files"] > 10
    ((begin_ns, end_ns),) = keeper.kept.spans()
    assert at(100) < begin_ns < end_ns == at(199)


def with_clock_set_back(folder: Path, before: int) -> Kept:
    """A ring of 20 frames, after `before` of which the clock was set back by an hour."""
    recorder = Keeper(Keep(folder, SMALL), KEYS)._files
    for number in range(20):
        back_ns = HOUR_NS if number >= before else 0
        assert recorder.write(message(number, number in (0, before), stamp_ns=at(number) - back_ns))
    recorder.close()
    return Kept(folder, KEYS, SMALL)


@pytest.mark.parametrize("before", [4, 12])
def test_what_came_after_the_clock_was_set_back_is_found_and_marked(tmp_path: Path, before: int) -> None:
    """It was in no list, and a mark on it protected nothing."""
    kept = with_clock_set_back(tmp_path, before)
    for back_ns, first in ((0, 0), (HOUR_NS, before)):
        (piece,), _ = kept.pieces(at(0) - back_ns, at(30) - back_ns)
        assert piece.begin_ns == at(first) - back_ns
        assert len(kept.part(piece.name, piece.begin_ns, 0, 10)) == 10
    kept.growing = max(files(tmp_path), key=lambda path: path.stat().st_mtime_ns)
    assert before < 10 or kept.until_ns() < at(0), "so the rest of a clip is waited for"
    kept.growing = None
    kept.marks.add(Mark("crash", at(before + 2) - HOUR_NS, at(before + 5) - HOUR_NS, "airbag", "test", at(0)))
    staying = [kept.stays(path) for path in files(tmp_path)]
    assert sorted(staying) == ([False, True] if before > 10 else [True])


def test_a_marked_span_stays_when_everything_around_it_is_overwritten(tmp_path: Path) -> None:
    keeper = ring(tmp_path, 0, 40)
    keeper.kept.mark(Mark("crash", at(5), at(8), "airbag", "test", at(9)))
    ring(tmp_path, 40, 200)
    left = ring(tmp_path, 200, 300).kept
    spans = left.spans()
    assert len(spans) == 2, "the marked one, and the newest"
    assert spans[0][0] <= at(5)
    assert spans[0][1] >= at(7)
    assert left.release("crash")
    assert not left.release("crash")
    assert ring(tmp_path, 300, 400).kept.spans()[0][0] > at(200)


def test_marks_take_at_most_half_of_the_ring(tmp_path: Path) -> None:
    keeper = ring(tmp_path, 0, 40)
    with pytest.raises(SettingsError, match=r"more than 37\.5%"):
        keeper.kept.mark(Mark("all", at(0), at(600), "", "", at(40)))
    assert not list(keeper.kept.marks)


def test_if_the_marks_cannot_be_read_nothing_is_deleted(tmp_path: Path) -> None:
    ring(tmp_path, 0, 40)
    (tmp_path / "car-7_roof.marks.json").write_text('{"marks": [{"name": "x"')
    first = files(tmp_path)[0]
    keeper = ring(tmp_path, 40, 140)
    assert first.exists()
    assert keeper.state()["stopped"] is not None


@pytest.mark.parametrize("size", ["64", "1 kB", "-4GB", "64GBB", "9" * 40 + "GB", "64 light years", "1e9GB"])
def test_sizes_that_are_none(size: str) -> None:
    with pytest.raises(SettingsError, match="write for example 64GB"):
        bytes_of(size)


def test_a_file_cut_at_any_byte_gives_every_whole_message_before_the_cut(tmp_path: Path) -> None:
    kept(tmp_path, 12)
    (path, *_) = files(tmp_path)
    whole = pieces_in(path)
    places = [place for piece in whole for place in piece.places]
    data = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    for size in range(1, len(data), 9973):
        cut.write_bytes(data[:size])
        found = pieces_in(cut) if size >= 8 else []
        want = [place for place in places if place[0] + place[1] <= size]
        assert [place for piece in found for place in piece.places] == want, size
        assert all(read_piece(cut, piece) for piece in found)


def test_a_growing_file_offers_complete_pieces_only_and_they_keep_their_names(tmp_path: Path) -> None:
    keeper = Keeper(Keep(tmp_path, 2**30), KEYS)
    keeper.start()
    feed(keeper, frames(25))
    assert eventually(lambda: keeper.state()["counts"].get("frames") == 25)
    early, more = keeper.kept.pieces(0, 2**62)
    assert not more
    assert keeper.kept.until_ns() == early[-1].end_ns
    keeper.close()
    late, _ = Kept(tmp_path, KEYS, 2**30).pieces(0, 2**62)
    assert [piece.name for piece in late[: len(early)]] == [piece.name for piece in early]
    assert len(late) == len(early) + 1


def test_a_slow_disk_drops_the_oldest_waiting_frames_and_says_so_at_the_vehicle(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    keeper = Keeper(Keep(tmp_path, SMALL), KEYS)  # it was not started, so it is as slow as can be
    for frame in frames(WAITING + 5):
        keeper.frame(frame)
    assert keeper.state()["counts"] == {"dropped": 5}
    assert caplog.text.count("--keep does not keep every frame") == 1, "once, then only counted"
    assert "5 of 25 not kept" in not_kept({"past": keeper.state(), "assembled": WAITING + 5})
    assert not_kept({"past": None, "assembled": 5}) == ""


def test_a_folder_that_cannot_be_used_stops_the_keeping_and_says_why(tmp_path: Path) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.write_text("no folder")
    keeper = kept(in_the_way, 3)
    assert keeper.state()["stopped"] is not None
    said = not_kept({"past": keeper.state(), "assembled": 3})  # the last line of `publish` left it out
    assert said == f", 3 of 3 not kept: {keeper.state()['stopped']}"
    assert keeper.kept.spans() == []


def test_a_condition_on_the_status_marks_the_time_around_it_once(tmp_path: Path) -> None:
    keeper = Keeper(Keep(tmp_path, SMALL, ("worker_restarts grows", "flight.in_flight > 3")), KEYS)
    status: dict[str, object] = {"worker_restarts": 0, "flight": {"in_flight": 1}}
    keeper.status = lambda: dict(status)
    keeper._watch()
    status["worker_restarts"] = 1
    for _ in range(3):
        keeper._watch()
    (mark,) = keeper.kept.marks
    assert (mark.reason, mark.by, mark.to_ns - mark.from_ns) == ("worker_restarts grows", "status", 30 * 10**9)
    assert mark.from_ns < mark.at_ns < mark.to_ns


def test_an_event_that_could_not_be_marked_is_marked_as_soon_as_that_can_be_done(tmp_path: Path) -> None:
    """A disk that was full at that moment: the crash was overwritten, as a condition comes true only once."""
    keeper = Keeper(Keep(tmp_path / "ring", SMALL, ("worker_restarts grows",)), KEYS)
    (tmp_path / "ring").write_text("no folder")  # a file in place of the folder: not even root can write in it
    keeper.status = lambda: {"worker_restarts": 0}
    keeper._watch()
    keeper.status = lambda: {"worker_restarts": 1}
    with pytest.raises(SourceError, match="the marks cannot be stored"):
        keeper._watch()
    keeper._watch()
    assert len(keeper.kept.marks) == 0
    (tmp_path / "ring").unlink()
    keeper._look_after(1e9)
    (mark,) = keeper.kept.marks
    assert mark.reason == "worker_restarts grows"
    assert Marks(keeper.kept.marks.path).covers(mark.from_ns, mark.to_ns)
    keeper._look_after(2e9)
    assert len(keeper.kept.marks) == 1


@pytest.mark.parametrize("text", ["", "x", "x > y", "x > 1 > 2", "x ! 3", "> 3", "x grows more", "x" * 300 + " grows"])
def test_conditions_that_are_none(tmp_path: Path, text: str) -> None:
    with pytest.raises(SettingsError, match="is not a condition"):
        Keeper(Keep(tmp_path, SMALL, (text,)), KEYS)


def test_marks_with_long_texts_are_refused_before_their_file_is_too_long_to_be_read(tmp_path: Path) -> None:
    """A file that cannot be read again lets no recording be deleted: the ring is full, and nothing more is kept."""
    marks = Marks(tmp_path / "a.marks.json")
    long = [Mark(f"m{number}", 1, 2, "é" * MAX_TEXT, "é" * MAX_TEXT, 3) for number in range(MAX_MARKS)]
    with pytest.raises(SettingsError, match="too much text"):
        any(marks.add(mark) for mark in long)
    again = Marks(marks.path)
    assert not again.damaged
    assert 50 < len(again) == len(marks)
    assert again.release("m0")


def test_marks_over_the_network_leave_room_to_those_that_the_vehicle_sets_itself(tmp_path: Path) -> None:
    """With 256 of them no event was marked any more, and its frames were overwritten."""
    kept = Kept(tmp_path, KEYS, SMALL)
    with pytest.raises(SettingsError, match="there are 192 marks"):
        any(kept.mark(Mark(f"m{number}", 1, 2, "", "", 3)) for number in range(MAX_MARKS))
    assert len(kept.marks) == 192
    kept.mark(Mark("crash", 1, 2, "airbag", "status", 3), own=True)
    assert len(Kept(tmp_path, KEYS, SMALL).marks) == 193

    for folder, own in ((tmp_path / "others", False), (tmp_path / "own", True)):
        keeper = ring(folder, 0, 60)
        spans = [at(n) for n in range(0, 60, 5)]
        with pytest.raises(SettingsError, match="more than"):
            any(keeper.kept.mark(Mark(f"m{ns}", ns, ns + 1, "", "", 3), own=own) for ns in spans)
        share = 0.5 if own else 0.375
        keeper.kept.look()
        assert (share - 0.2) * SMALL < keeper.state()["marked_bytes"] <= share * SMALL


def test_a_disk_that_fails_again_and_again_costs_no_handles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "AGAIN_S", 0.0)
    monkeypatch.setattr(module, "SYNC_S", 0.01)
    keeper = Keeper(Keep(tmp_path / "file", SMALL), KEYS)
    (tmp_path / "file").write_text("no folder")
    made: list[object] = []
    monkeypatch.setattr(keeper, "_recorder", lambda make=keeper._recorder: made.append(make()) or made[-1])
    keeper.start()
    handles = lambda: len(list(Path("/proc/self/fd").iterdir()))  # noqa: E731
    try:
        assert eventually(lambda: feed(keeper, frames(1)) or len(made) > 2)
        before, count = handles(), len(made)
        assert eventually(lambda: feed(keeper, frames(1)) or len(made) > count + 10)
        assert handles() < before + 10, "three for each that was not closed"
    finally:
        keeper.close()


def test_a_recorder_and_a_keeper_have_folders_of_their_own(tmp_path: Path) -> None:
    """Each would delete the files of the other, marked ones too."""
    with pytest.raises(SettingsError, match="different folders"):
        check_apart(Record(tmp_path / "a" / ".." / "b"), Keep(tmp_path / "b", SMALL))
    check_apart(Record(tmp_path / "a"), Keep(tmp_path / "b", SMALL))


def test_a_marked_file_that_cannot_be_opened_now_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keeper = kept(tmp_path, 25)
    (file, *_) = files(tmp_path)
    keeper.kept.mark(Mark("crash", at(3), at(4), "", "", 1))
    again = Kept(tmp_path, KEYS, SMALL)
    monkeypatch.setattr("lidarcodec.apps.past.kept.open_regular", lambda path: (_ for _ in ()).throw(OSError(24, "x")))
    assert again.stays(file)
    assert not again.stays(file.with_name("gone.mcap"))
