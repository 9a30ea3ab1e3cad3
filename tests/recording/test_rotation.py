"""The recorder on the vehicle: it may fill its share of the disk and no more, and never take the stream with it."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from lidarcodec import wire
from lidarcodec.errors import HeaderError, SettingsError
from lidarcodec.recording import RecordingReader, RotatingRecorder
from tests.recording.test_recording import drive, message, packet

MIB = 2**20


def big(index: int, key: bool) -> bytes:
    """A message of 100 kB."""
    return message(index, key, size=100_000)


def test_a_clock_that_is_set_back_begins_a_file_and_one_that_jumps_does_not_begin_many(tmp_path: Path) -> None:
    """A file whose times go back was said to end where it began."""
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=4 * MIB)
    for index in range(60):
        stamp_ns = 10**18 + index * 10**8 - (3600 * 10**9 if index >= 30 and index % 2 else 0)
        assert recorder.write(message(index, True, stamp_ns=stamp_ns))
    recorder.close()
    assert len(recorder.files()) == 3
    for path in recorder.files():
        with path.open("rb") as file:
            stamps = [stamp for stamp, _ in RecordingReader(file).messages()]
            assert RecordingReader(file).span() == (min(stamps), max(stamps))


def test_a_clock_that_jumps_all_the_time_makes_few_files(tmp_path: Path) -> None:
    """Each file is looked at when the next one begins: with a file a second a recorder fell behind within a day."""
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=4 * MIB)
    for index in range(2000):
        assert recorder.write(message(index, True, stamp_ns=10**18 - 3600 * 10**9 * (index // 10 % 2)))
    recorder.close()
    assert len(recorder.files()) <= 8
    assert recorder.counts["messages"] == 2000


def test_files_are_changed_at_key_messages_and_the_oldest_go(tmp_path: Path) -> None:
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=4 * MIB)
    for index in range(200):
        assert recorder.write(big(index, index % 5 == 0))
        assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 4 * MIB
    recorder.close()
    recorder.close()
    files = recorder.files()
    assert 3 <= len(files) == recorder.counts["files"] - recorder.counts["deleted files"]
    indices: list[int] = []
    for path in files:
        assert path.stat().st_size <= MIB
        with path.open("rb") as file:
            reader = RecordingReader(file)
            headers = [wire.peek(data) for _, data in reader.messages()]
            assert not reader.counts
        assert headers[0].key
        indices += [header.frame_index for header in headers]
    assert indices == list(range(indices[0], 200)), "what is left is the newest, without a gap"
    assert recorder.stopped is None


def spoil(path: Path, what: str) -> None:
    """Do to a file what somebody might do while it is being written."""
    if what == "file":
        path.unlink()
    elif what == "folder":
        shutil.rmtree(path.parent)
    elif what == "replaced":
        other = path.with_suffix(".tmp")
        other.write_bytes(b"other")
        other.replace(path)
    else:
        path.write_bytes(b"" if what == "cut" else bytes(10_000_000))


@pytest.mark.parametrize("kind", ["messages", "packets"])
@pytest.mark.parametrize("what", ["file", "folder", "replaced", "cut", "over"])
def test_a_file_that_is_removed_replaced_or_written_over_is_told_and_another_one_begins(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: str, what: str
) -> None:
    """All that followed went into a file that nobody could open, and nobody was told."""
    folder = tmp_path / "kept"
    recorder = RotatingRecorder(folder, "truck", "roof")
    for index, data in enumerate(drive(10, 2)):
        if kind == "messages":
            recorder.write(data)
        else:
            recorder.write_packets([packet(index)])
        if index == 3:
            spoil(next(folder.iterdir()), what)
    recorder.close()
    path = recorder.files()[-1]
    with path.open("rb") as file:
        reader = RecordingReader(file)
        assert len(list(reader.messages() if kind == "messages" else reader.packets())) == 6
    assert recorder.counts["lost files"] == 1
    assert "its content is lost" in caplog.text
    if what == "replaced":
        assert recorder.files()[0].read_bytes() == b"other", "what others put there is theirs"


def test_a_recorder_waits_for_a_key_message(tmp_path: Path) -> None:
    recorder = RotatingRecorder(tmp_path, "truck", "roof")
    assert [recorder.write(one) for one in drive(10, 4)[1:]] == [False] * 3 + [True] * 6
    assert recorder.counts["waiting for a key message"] == 3
    recorder.close()


def test_a_stream_whose_key_messages_are_rare_stays_within_the_folder(tmp_path: Path) -> None:
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=3 * MIB)
    done = [recorder.write(big(index, index in (0, 20))) for index in range(60)]
    assert all(done[:40])
    assert not done[-1]
    assert "no key frame" in str(recorder.stopped)
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 3 * MIB


def test_files_of_others_are_left_alone(tmp_path: Path) -> None:
    for name in ("holiday.mcap", "truck_roof_x.mcap", "truck2_roof_20200101T000000Z_0000.mcap"):
        (tmp_path / name).write_bytes(bytes(3 * MIB))
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=2 * MIB)
    for index in range(60):
        recorder.write(big(index, True))
    recorder.close()
    assert len([path for path in tmp_path.iterdir() if path.stat().st_size == 3 * MIB]) == 3
    assert recorder.counts["deleted files"] > 0


def test_old_files_that_somebody_takes_away_end_no_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "truck_roof_20200101T000000Z_0000.mcap").symlink_to(tmp_path / "nowhere")
    taken = Path.unlink

    def gone(path: Path, missing_ok: bool = False) -> None:
        taken(path)
        taken(path, missing_ok=missing_ok)

    monkeypatch.setattr(Path, "unlink", gone)
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=2 * MIB)
    assert all(recorder.write(big(index, True)) for index in range(60))
    recorder.close()
    assert recorder.stopped is None
    assert recorder.counts["deleted files"] > 0


def test_files_of_another_sensor_are_left_alone_though_their_names_are_alike(tmp_path: Path) -> None:
    for vehicle, sensor in (("car", "1_roof"), ("car_1", "roof")):
        recorder = RotatingRecorder(tmp_path, vehicle, sensor, max_file_bytes=MIB, max_total_bytes=2 * MIB)
        for index in range(60):
            recorder.write(big(index, True))
        recorder.close()
        assert recorder.counts["deleted files"] > 0
    assert len(RotatingRecorder(tmp_path, "car", "1_roof").files()) >= 2


def test_files_of_an_earlier_run_count(tmp_path: Path) -> None:
    for _ in range(3):
        recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=2 * MIB)
        for index in range(15):
            recorder.write(big(index, True))
        recorder.close()
        assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 2 * MIB


def test_packets_are_rotated_too(tmp_path: Path) -> None:
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=3 * MIB)
    for at in range(0, 3480, 348):
        assert recorder.write_packets([packet(number) for number in range(at, at + 348)])
    assert recorder.write_packets([])
    recorder.close()
    came = []
    for path in recorder.files():
        with path.open("rb") as file:
            came += list(RecordingReader(file).packets())
    assert came == [packet(number) for number in range(3480 - len(came), 3480)]
    assert len(came) >= 348


def test_a_full_disk_stops_the_recording_and_nothing_else(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recorder = RotatingRecorder(tmp_path, "truck", "roof")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (350_000, before[1]))
    try:
        done = [recorder.write(big(index, index == 0)) for index in range(8)]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert done == [True] * 3 + [False] * 5
    assert recorder.counts["not recorded"] == 5
    assert recorder.stopped
    assert len(caplog.records) == 1
    recorder.close()
    with recorder.files()[0].open("rb") as file:
        assert len(list(RecordingReader(file).messages())) == 3


@contextlib.contextmanager
def no_more_files() -> Iterator[list[int]]:
    """All handles that this process may open are taken, as by connections of strangers; gives those that are."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (sum(1 for _ in Path("/proc/self/fd").iterdir()) + 64, before[1]))
    taken: list[int] = []
    try:
        with contextlib.suppress(OSError):
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        yield taken
    finally:
        for handle in taken:
            os.close(handle)
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_recording_goes_on_when_strangers_hold_all_open_files(tmp_path: Path) -> None:
    """It stopped for good at its next file."""
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=100 * MIB)
    assert recorder.write(big(0, True))
    with no_more_files():
        assert all(recorder.write(big(index, True)) for index in range(1, 40))
    recorder.close()
    assert recorder.counts["files"] == 4
    assert recorder.stopped is None
    indices: list[int] = []
    for path in recorder.files():
        with path.open("rb") as file:
            indices += [wire.peek(data).frame_index for _, data in RecordingReader(file).messages()]
    assert indices == list(range(40))


def test_a_file_goes_on_when_even_the_handles_in_reserve_are_taken(tmp_path: Path) -> None:
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=100 * MIB)
    assert recorder.write(big(0, True))
    with no_more_files() as taken:
        recorder._spare.close()
        with contextlib.suppress(OSError):
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        recorder._spare.fill()
        os.close(taken.pop())  # one for the list of the folder's files
        assert all(recorder.write(big(index, True)) for index in range(1, 40))
        assert recorder.counts["files"] == 1
    assert recorder.write(big(40, True))
    assert recorder.counts["files"] == 2
    recorder.close()


def test_a_folder_that_cannot_be_written_stops_the_recording(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    recorder = RotatingRecorder(tmp_path / "file" / "folder", "truck", "roof")
    assert not recorder.write(big(0, True))
    assert recorder.stopped


def test_what_is_on_disk_after_a_kill_can_be_read(tmp_path: Path) -> None:
    """Every message is handed to the operating system at once: a process that dies loses none."""
    recorder = RotatingRecorder(tmp_path, "truck", "roof")
    data = drive(9)
    for one in data:
        recorder.write(one)
    path = recorder.path
    assert path is not None
    copy = tmp_path / "copy"
    copy.write_bytes(path.read_bytes())
    with copy.open("rb") as file:
        assert [one for _, one in RecordingReader(file).messages()] == data
    recorder.close()
    assert recorder.path is None


def test_sizes_that_leave_no_room_are_refused(tmp_path: Path) -> None:
    for sizes in ({"max_file_bytes": 1000}, {"max_file_bytes": 2 * MIB, "max_total_bytes": 3 * MIB}):
        with pytest.raises(SettingsError, match="at least"):
            RotatingRecorder(tmp_path, "truck", "roof", **sizes)
    with pytest.raises(HeaderError):
        RotatingRecorder(tmp_path, "truck", "roof").write(b"nothing")
    assert not list(tmp_path.iterdir())


def filled(recorder: RotatingRecorder, messages: int) -> None:
    for index in range(messages):
        assert recorder.write(big(index, True))


def test_a_clock_that_is_behind_does_not_make_the_newest_files_the_oldest(tmp_path: Path) -> None:
    """A vehicle without a clock of its own begins in 1970: what it recorded a minute ago was deleted first."""
    earlier = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=4 * MIB)
    filled(earlier, 30)
    earlier.close()
    old = earlier.files()
    for path in old:
        os.utime(path, (2e9, 2e9))
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=4 * MIB)
    filled(recorder, 25)
    recorder.close()
    assert recorder.counts["deleted files"] > 0
    assert len(set(recorder.files()) - set(old)) == recorder.counts["files"], "all of this drive is there"


def test_a_file_that_somebody_else_writes_is_not_deleted(tmp_path: Path) -> None:
    """Two publishers with one name and one folder: each deleted what the other was writing, and neither said so."""
    other = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=3 * MIB)
    filled(other, 3)
    assert other.path is not None
    recorder = RotatingRecorder(tmp_path, "truck", "roof", max_file_bytes=MIB, max_total_bytes=3 * MIB)
    filled(recorder, 60)
    assert other.path.exists()
    filled(other, 3)
    kept = other.path
    other.close()
    with kept.open("rb") as file:
        assert len(list(RecordingReader(file).messages())) == 6
    filled(recorder, 60)
    assert not kept.exists(), "it is one of the oldest once it is closed"
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 3 * MIB
    recorder.close()
