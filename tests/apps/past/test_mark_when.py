"""Events of --mark-when: a condition that comes and goes takes no place of those that come later."""

from __future__ import annotations

from pathlib import Path

import pytest

from lidarcodec.apps.past import keeper as module
from lidarcodec.apps.past.keeper import MARK_NS, Keep, Keeper
from lidarcodec.recording.marks import MAX_MARKS, Mark, Marks, covered
from tests.apps.past.kept_drive import KEYS, SMALL, at, ring

SECOND_NS = 10**9
FLAPS, OTHER = "flight.in_flight > 3", "worker_restarts grows"


class Drive:
    """A keeper, and the clock and the status that it looks at."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.keeper = Keeper(Keep(folder, SMALL, (FLAPS, OTHER)), KEYS)
        self.status = {"flight": {"in_flight": 0}, "worker_restarts": 0}
        self.keeper.status = lambda: self.status
        self.now_ns = at(0)
        monkeypatch.setattr(module.time, "time_ns", lambda: self.now_ns)
        self.keeper._watch()

    def flap(self) -> int:
        """The condition comes true and is false again, within two seconds. Returns when it came."""
        self.status["flight"] = {"in_flight": 4}
        self.keeper._watch()
        came_ns = self.now_ns
        self.now_ns += SECOND_NS
        self.status["flight"] = {"in_flight": 0}
        self.keeper._watch()
        self.now_ns += SECOND_NS
        return came_ns

    @property
    def marks(self) -> list[Mark]:
        return list(self.keeper.kept.marks)


@pytest.fixture
def drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Drive:
    return Drive(tmp_path, monkeypatch)


def test_a_condition_that_flaps_takes_one_mark_for_each_clip_and_leaves_nothing_out(drive: Drive) -> None:
    """Each time took a mark: 256 in nine minutes, and then no event was marked any more."""
    came = [drive.flap() for _ in range(300)]  # ten minutes
    spans = [(ns, ns + 1) for event_ns in came for ns in range(event_ns - MARK_NS, event_ns + MARK_NS, SECOND_NS)]
    assert all(covered(drive.marks, *span) for span in spans)
    assert len(drive.marks) <= 600 // 30 + 2
    drive.status["worker_restarts"] = 1
    drive.keeper._watch()
    assert drive.marks[-1].reason == OTHER


def test_what_somebody_released_is_marked_again(drive: Drive) -> None:
    drive.flap()
    assert drive.keeper.kept.release(drive.marks[0].name)
    came_ns = drive.flap()
    assert covered(drive.marks, came_ns, came_ns + 1)


def test_after_the_clock_was_set_back_an_event_has_a_clip_of_its_own(drive: Drive) -> None:
    drive.flap()
    drive.now_ns -= 3600 * SECOND_NS
    came_ns = drive.flap()
    assert covered(drive.marks, came_ns, came_ns + 1)


def test_the_newest_event_takes_the_place_of_the_oldest_of_its_condition(drive: Drive) -> None:
    """With 256 marks, those of weeks ago stayed and the crash of today was overwritten."""
    old = [Mark(f"m{n}", at(n), at(n) + 1, OTHER if n == 0 else FLAPS, "status", at(n)) for n in range(MAX_MARKS - 2)]
    drive.keeper.kept.marks._store(tuple(old))
    drive.now_ns += 3600 * SECOND_NS
    for number in range(6):
        drive.now_ns += 60 * SECOND_NS
        came_ns = drive.flap()
        assert covered(drive.marks, came_ns, came_ns + 1), number
    assert len(drive.marks) == MAX_MARKS
    assert drive.marks[0].reason == OTHER, "the events of another condition stay"
    assert drive.keeper.state()["counts"] == {"marks released": 4}
    assert [one.name for one in Marks(drive.keeper.kept.marks.path)] == [one.name for one in drive.marks]


def test_marks_give_way_only_as_far_as_a_newer_one_has_room_then(tmp_path: Path) -> None:
    kept = ring(tmp_path, 0, 60).kept
    marks = [Mark(f"m{n}", at(n), at(n) + 1, FLAPS, "status", at(n)) for n in (5, 20, 35)]
    assert [kept.mark(one, own=True) for one in marks] == [0, 0, 0]
    newer = Mark("new", at(48), at(49), FLAPS, "status", at(50))
    kept.max_bytes = 2 * kept._marked_bytes([span for _, span in kept._files()])  # there is room for these three
    assert kept.mark(newer, own=True, instead_of=marks) == 1
    assert [one.name for one in kept.marks] == ["m20", "m35", "new"]
    too_long = Mark("long", at(0), at(600), FLAPS, "status", at(60))
    with pytest.raises(module.SettingsError, match="more than"):
        kept.mark(too_long, own=True, instead_of=list(kept.marks))
    assert len(kept.marks) == 3, "none was released for nothing"
