"""How fetches end at bad moments: cancelled while a clip is written, on a full disk, and while somebody keeps it."""

from __future__ import annotations

import threading

import pytest

from lidarcodec.apps.past.plan import Clip
from lidarcodec.errors import SourceError
from lidarcodec_server.past.clips import Clips
from lidarcodec_server.past.fetches import Fetches
from tests.apps.past.kept_drive import KEYS, at
from tests.transport.test_contract import eventually

CLIP = Clip(KEYS, at(12), at(27))


class Pausing(Clips):
    """A folder of clips that calls a function before the state of a fetch that is complete is stored."""

    def __init__(self, folder, before):
        super().__init__(folder, 1 << 30)
        self.before = before

    def write(self, record):
        if record.state == "complete":
            self.before(record)
        super().write(record)


@pytest.fixture
def beginning(keeping, network, tmp_path):
    """Function that starts fetches of car-7 into the folder; they are closed after the test. clips: the folder"""
    keeping()
    started = []

    def begin(clips):
        started.append(Fetches(clips, network.transport))
        started[-1].start()
        return started[-1]

    yield begin
    for one in started:
        one.close()


def state(fetches, record):
    return fetches.state(record.id)[0].state


def test_a_fetch_that_is_cancelled_while_its_clip_is_written_is_cancelled(beginning, tmp_path):
    """The answer was that it is cancelled; then it was complete, and took room."""
    clips = Clips(tmp_path / "clips", 1 << 30)
    fetches = beginning(clips)
    write, writing, go_on = fetches._assemble, threading.Event(), threading.Event()

    def assembled(job, plan):
        found = write(job, plan)
        writing.set()
        assert go_on.wait(60)
        return found

    fetches._assemble = assembled
    record = fetches.begin(CLIP, "olga")
    assert writing.wait(60)
    fetches.cancel(record.id)
    go_on.set()
    assert eventually(lambda: state(fetches, record) != "running", 60)
    assert state(fetches, record) == "cancelled"
    assert fetches.here(CLIP) is None
    assert eventually(lambda: not list(clips.store.folder.glob("*")), 60)
    assert not clips.clip_file(record).exists()


def test_a_clip_whose_end_could_not_be_stored_is_here_after_a_restart(beginning, tmp_path):
    """On a full disk. It was fetched again, though it was here, and it was lost if the vehicle was away."""

    def full(record):
        raise clips._unusable(OSError(28, "No space left on device"))

    clips = Pausing(tmp_path / "clips", full)
    fetches = beginning(clips)
    record = fetches.begin(CLIP, "olga")
    assert eventually(lambda: state(fetches, record) == "complete", 60)
    fetches.close()
    again = Fetches(Clips(tmp_path / "clips", 1 << 30), lambda: None)  # the vehicle is away
    again.start()
    found = again.here(CLIP)
    again.close()
    assert found is not None
    assert (found.state, found.size) == ("complete", clips.clip_file(record).stat().st_size)


def test_a_clip_that_is_kept_at_the_moment_it_is_complete_stays_and_stays_complete(beginning, tmp_path):
    """The later of two writes won: it was not kept, or was running again after a restart."""
    keeping, kept = threading.Thread(target=lambda: fetches.keep(CLIP)), threading.Event()

    def keep(record):
        if not kept.is_set():
            kept.set()
            keeping.start()
            keeping.join(2.0)  # as far as it comes

    clips = Pausing(tmp_path / "clips", keep)
    fetches = beginning(clips)
    fetches.begin(CLIP, "olga")
    assert kept.wait(60)
    fetches.close()
    keeping.join(60)
    (found,) = Clips(tmp_path / "clips", 1 << 30).records()
    assert (found.state, found.stays) == ("complete", True)


def test_who_asks_for_a_clip_whose_fetch_was_just_cancelled_has_a_fetch_of_his_own(beginning, tmp_path):
    """He joined the one that ended a moment later as cancelled: nobody fetched the clip of the mark that he set."""
    fetches = beginning(Clips(tmp_path / "clips", 1 << 30))
    write, writing, go_on = fetches._assemble, threading.Event(), threading.Event()

    def assembled(job, plan):
        writing.set()
        assert go_on.wait(60)
        return write(job, plan)

    fetches._assemble = assembled
    cancelled = fetches.begin(CLIP, "olga")
    assert writing.wait(60)
    fetches.cancel(cancelled.id)
    assert fetches.running(CLIP) is None
    assert fetches.keep(CLIP) is None
    record = fetches.begin(CLIP, "otto", stays=True)
    go_on.set()
    assert eventually(lambda: state(fetches, record) == "complete", 60)
    assert record.id != cancelled.id
    assert state(fetches, cancelled) == "cancelled"
    assert fetches.here(CLIP).stays


def test_a_clip_that_is_kept_while_another_fetch_makes_room_is_not_deleted(beginning, tmp_path):
    """Somebody marked its span, and was told that the clip is here and stays; a moment later it was gone."""

    class Reading(Clips):
        """A folder of clips in which one is kept after it was found that others may give way."""

        def take_from_clips(self, plan, done):
            super().take_from_clips(plan, done)
            if done:
                self.max_bytes = 2 * sum(piece.size for piece in plan.there) + done[0].size - 1
                fetches.keep(CLIP)

    clips = Reading(tmp_path / "clips", 1 << 30)
    fetches = beginning(clips)
    record = fetches.begin(CLIP, "olga")
    assert eventually(lambda: state(fetches, record) == "complete", 60)
    other = fetches.begin(Clip(KEYS, at(32), at(42)), "otto")
    assert eventually(lambda: state(fetches, other) == "failed", 60)
    assert clips.clip_file(record).is_file()
    assert fetches.here(CLIP).stays


def test_two_servers_with_one_folder_do_not_delete_each_others_clips(beginning, tmp_path):
    """Both fetched what waited there. The first to be done deleted the pieces of the other, which then failed, and
    deleted the clip of the first: it was complete, and not there."""
    first = beginning(Clips(tmp_path / "clips", 1 << 30))
    second = beginning(Clips(tmp_path / "clips", 1 << 30))
    record = first.begin(CLIP, "olga")
    with pytest.raises(SourceError, match="another server uses the folder of clips"):
        second.begin(Clip(KEYS, at(32), at(42)), "otto")
    assert second.all() == []
    assert eventually(lambda: state(first, record) == "complete", 60)
    first.close()
    assert eventually(lambda: second.here(CLIP) is not None, 60), "it goes on with what the first one had"
    assert second.begin(Clip(KEYS, at(32), at(42)), "otto").state == "running"
