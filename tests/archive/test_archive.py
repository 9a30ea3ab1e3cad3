"""Through the whole archive: run, query, get, verify, recompress, repair; on a folder, without other processes."""

from __future__ import annotations

import json

import pytest

import lidarcodec
from lidarcodec.archive import contents
from lidarcodec.archive.archive import open_archive
from lidarcodec.archive.plan import _difference
from lidarcodec.sources import open_source
from lidarcodec.untrusted.times import rfc_3339
from tests.archive.conftest import FRAMES, SHORT, archive, objects, payloads, unchanged
from tests.command_line import run_here


def test_packets_come_back_and_a_second_run_does_nothing(inputs, filled, tmp_path):
    archive("get", filled, tmp_path / "back.pcap", "--vehicle", "car-7")
    assert payloads(tmp_path / "back.pcap") == payloads(inputs / "car-7/roof/drive.pcap")
    with unchanged(filled):
        done = archive("run", inputs, filled, *SHORT, "--json")
    told = json.loads(done.stdout)
    assert (told["inputs"], told["finished"], told["tasks"], told["aside"]) == (1, 1, 0, [])
    assert not [path for path in filled.rglob(".*") if path.is_file()]


@pytest.mark.sweep
def test_equal_runs_give_equal_objects(inputs, filled, tmp_path):
    again = tmp_path / "again"
    archive("run", inputs, again, *SHORT)
    assert objects(again) == objects(filled)


def test_a_query_sees_every_frame_once(inputs, filled):
    done = archive("query", filled, "select vehicle, sensor, count(*) n, sum(packets) p, max(error_m) e from frames "
                   "group by all", "--json")  # fmt: skip
    packets = len(payloads(inputs / "car-7/roof/drive.pcap"))
    assert json.loads(done.stdout) == {
        "columns": ["vehicle", "sensor", "n", "p", "e"],
        "rows": [["car-7", "roof", FRAMES, packets, 0.0]],
        "lost": 0,
    }
    wrong = run_here("archive", "query", str(filled), "select nothing from frames")
    assert wrong.returncode == 2
    assert "the query cannot be run" in wrong.stderr


def test_frames_by_time_and_by_condition(filled):
    found = open_archive(filled)
    every = list(found.frames())
    between = (every[2].stamp_ns, every[3].stamp_ns)
    chosen = list(found.frames(vehicle="car-7", sensor="roof", between=between))
    assert [frame.stamp_ns for frame in chosen] == list(between)
    assert (chosen[0].range == every[2].range).all()
    (same,) = found.frames(where=f"stamp_ns = {between[0]}")
    assert same.stamp_ns == between[0]
    assert list(found.frames(vehicle="car-8")) == []
    with pytest.raises(lidarcodec.errors.SettingsError, match="is not a time"):
        list(found.frames(between=("yesterday", "today")))


def test_a_mistyped_folder_is_no_empty_archive(inputs, filled, tmp_path):
    wrong = tmp_path / "mistyped"
    for words in (
        ("run", wrong, tmp_path / "out"),
        ("run", inputs, wrong, "--job", "verify"),
        ("run", wrong, wrong, "--job", "stats"),
        ("query", wrong, "select 1"),
        ("get", wrong, tmp_path / "a.pcap"),
    ):
        assert "is not a folder" in archive(*words, code=1).stderr
    with pytest.raises(lidarcodec.errors.SourceError, match="is not a folder"):
        lidarcodec.open_archive(wrong)
    assert not wrong.exists()
    assert "the query is empty" in archive("query", filled, "", code=2).stderr


def test_points_of_some_frames(filled, tmp_path):
    archive("get", filled, tmp_path / "some.ply", "--where", "frame = 1")
    assert (tmp_path / "some.ply").stat().st_size > 10_000


def test_second_returns_that_are_not_among_the_points_are_told(tmp_path, caplog):
    drive = tmp_path / "in/car-7/roof/drive.pcap"
    drive.parent.mkdir(parents=True)
    assert run_here("simulate", "sim:garage?sensor=vlp16&returns=dual&frames=1", drive).returncode == 0
    archive("run", tmp_path / "in", tmp_path / "out", "--workers", "here")
    archive("get", tmp_path / "out", tmp_path / "a.ply")
    assert "a.ply: " in caplog.text
    assert " second returns left out" in caplog.text


def test_frames_that_are_not_there_are_explained(filled, tmp_path):
    out = tmp_path / "some.ply"
    begun = next(open_archive(filled).frames()).stamp_ns
    late = archive("get", filled, out, "--from", "2031-01-01T00:00:00Z", code=1).stderr
    assert f"fits these options (there are frames from {rfc_3339(begun)} to 20" in late
    placed = archive("get", filled, out, "--where", "x between 0 and 9", code=1).stderr
    assert "fits these options (no frame has a known pose, so x is null): nothing was written" in placed
    assert "fits these options: nothing" in archive("get", filled, out, "--where", "frame = 99", code=1).stderr


def test_a_recording_of_some_frames_is_read_by_decode(filled, tmp_path):
    archive("get", filled, tmp_path / "some.mcap", "--where", "frame = 1")
    expected = [frame.stamp_ns for frame in open_archive(filled).frames(where="frame = 1")]
    with open_source(tmp_path / "some.mcap") as source:
        assert [frame.stamp_ns for frame in source.frames()] == expected
    assert len(expected) == 2


def test_predicted_frames_bring_what_they_need(inputs, tmp_path):
    out = tmp_path / "out"
    archive("run", inputs, out, "--workers", "here", "--codec", "predictive")
    (frame,) = open_archive(out).frames(where="frame = 4")
    with open_source(inputs / "car-7/roof/drive.pcap") as source:
        expected = list(lidarcodec.read_frames(source, "packets"))[4]
    assert (frame.range == expected.range).all()


def test_verify_compares_with_the_input_and_finds_damage(inputs, filled):
    done = archive("run", inputs, filled, "--job", "verify", "--workers", "here", "--json")
    assert json.loads(done.stdout)["compared"] == 2
    recording = next(filled.rglob("*.mcap"))
    data = bytearray(recording.read_bytes())
    data[len(data) // 2] ^= 1
    recording.write_bytes(data)
    done = archive("run", inputs, filled, "--job", "verify", "--workers", "here", code=1)
    assert "BROKEN recordings/car-7/roof/" in done.stdout


def test_recompress_replaces_in_one_step_and_deletes_only_when_told(inputs, filled):
    before = objects(filled)
    words = ("run", filled, filled, "--job", "recompress", "--set", "max_error_m=0.05", "--workers", "here")
    with unchanged(filled):
        done = archive(*words, "--dry-run", "--json")
    assert json.loads(done.stdout)["segments"] == 2
    archive(*words)
    assert objects(filled).items() >= before.items()
    (row,) = open_archive(filled).query("select count(*), min(bound_m), max(error_m) > 0 from frames")[1]
    assert row[0] == FRAMES
    assert row[1] <= 0.05
    assert row[2]
    archive(*words, "--delete-old")
    gone = before.keys() - objects(filled).keys()
    assert {name.partition("/")[0] for name in gone} == {"recordings", "frames"}
    assert len(list(open_archive(filled).frames())) == FRAMES
    with unchanged(filled):
        archive("run", inputs, filled, *SHORT)


@pytest.mark.sweep
def test_a_segment_that_was_replaced_twice_is_visible_once(filled):
    """What an earlier run replaced and left is only deleted: encoded again, every frame would be there twice."""
    words = ("run", filled, filled, "--job", "recompress", "--workers", "here")
    archive(*words, "--codec", "raw")
    archive(*words, "--codec", "zstd", "--delete-old")
    assert open_archive(filled).query("select count(*) from frames")[1] == [(FRAMES,)]
    assert len(list(open_archive(filled).frames())) == FRAMES
    archive(*words, "--codec", "zstd", "--delete-old")
    segments = open_archive(filled).query("select distinct segment from frames")[1]
    assert len(list((filled / "recordings").rglob("*.mcap"))) == len(segments)


def test_an_archive_within_its_inputs_is_refused(inputs):
    done = run_here("archive", "run", str(inputs), str(inputs / "archive"))
    assert done.returncode == 2
    assert "would be read as input" in done.stderr


def test_broken_and_unknown_inputs_are_set_aside_and_stop_nothing(inputs, tmp_path, caplog):
    (inputs / "broken.pcap").write_bytes(b"no capture at all")
    (inputs / "empty.mcap").write_bytes(b"")
    (inputs / "notes.txt").write_text("not an input")
    (inputs / "link.pcap").symlink_to("/etc/passwd")
    (inputs / "\x1b[2J.pcap").write_bytes(b"a name that clears a terminal")
    out = tmp_path / "out"
    done = archive("run", inputs, out, *SHORT, "--json", code=1)
    told = json.loads(done.stdout)
    assert told["frames"] == FRAMES
    assert {one["what"] for one in told["aside"]} == {"broken.pcap", "empty.mcap", "link.pcap", "\\x1b[2J.pcap"}
    assert "\x1b" not in done.stderr
    assert "\x1b" not in archive("query", out, "select chr(27) as a").stdout
    whys = [json.loads(path.read_text()) for path in (out / "aside").iterdir()]
    assert {"what": "link.pcap", "why": "it is a link that leaves its folder"} in whys
    assert not [one for one in whys if str(tmp_path) in one["why"]]
    told = json.loads(archive("run", inputs, out, *SHORT, "--json", code=1).stdout)
    assert (told["finished"], told["earlier_aside"], told["aside"]) == (5, 4, [])
    assert "4 of the inputs were set aside by an earlier run" in caplog.text
    done = archive("run", inputs, out, *SHORT, "--repair", "--json", code=1)
    assert json.loads(done.stdout)["repaired"]["aside"] == 4


@pytest.mark.sweep
def test_what_was_not_compared_is_compared_later_and_what_was_made_again_is_verified_again(inputs, filled):
    def verified(source, *words) -> tuple[int, ...]:
        done = archive("run", source, filled, "--job", "verify", "--workers", "here", "--json", *words)
        return tuple(json.loads(done.stdout)[name] for name in ("compared", "unchanged", "finished", "segments"))

    assert verified(filled) == (0, 0, 0, 2)
    assert verified(filled) == (0, 2, 0, 0)
    assert verified(inputs) == (2, 0, 0, 2)
    assert verified(inputs) == (0, 0, 2, 0)
    next((filled / "recordings").rglob("*.mcap")).unlink()
    archive("run", inputs, filled, *SHORT, "--repair")
    assert verified(inputs) == (1, 0, 1, 1)


def test_joined_tables_say_the_same(filled, monkeypatch, caplog):
    monkeypatch.setattr("lidarcodec.archive.index.FAN_IN", 2)
    query = "select * from frames order by stamp_ns"
    before = open_archive(filled).query(query)
    archive("run", filled, filled, "--job", "index")
    assert list((filled / "index").glob("*.parquet"))
    next((filled / "frames").rglob("*.parquet")).unlink()
    assert open_archive(filled).query(query) == before
    words = ("run", filled, filled, "--job", "recompress", "--set", "max_error_m=0.05", "--workers", "here")
    done = archive(*words, "--json")
    assert (json.loads(done.stdout)["joined"], json.loads(done.stdout)["removed"]) == (1, 1)
    assert len(open_archive(filled).query(query)[1]) == FRAMES
    damaged = next((filled / "index").glob("*.json"))
    damaged.write_text('{"segments": [[[')
    assert len(open_archive(filled).query(query)[1]) == FRAMES
    assert "is damaged and is not used" in caplog.text
    done = archive("run", filled, filled, "--job", "index", "--json")
    assert json.loads(done.stdout)["removed"] == 1


@pytest.mark.sweep
def test_a_table_that_was_replaced_between_two_listings_is_not_missed(filled, monkeypatch, caplog):
    whole, asked = contents.tables_of, []

    def after_a_recompress(*words):
        if not asked:
            words_of = ("--job", "recompress", "--codec", "zstd", "--delete-old", "--workers", "here")
            asked.append(words)
            archive("run", filled, filled, *words_of)
        return whole(*words)

    monkeypatch.setattr("lidarcodec.archive.index.tables_of", after_a_recompress)
    assert open_archive(filled).query("select count(*) from frames")[1] == [(FRAMES,)]
    assert "lost their tables" not in caplog.text


def test_other_settings_do_not_archive_an_input_twice(inputs, filled, caplog):
    other = ("run", inputs, filled, *SHORT, "--codec", "zstd")
    with unchanged(filled):
        done = archive(*other, "--json")
    told = json.loads(done.stdout)
    assert (told["other_settings"], told["unfinished"], told["tasks"]) == (1, 0, 0)
    assert "with other settings (codec=pcodec)" in caplog.text
    assert "--job recompress replaces them, --keep-both adds them once more" in caplog.text
    next((filled / "commits").rglob("*.json")).unlink()
    done = archive(*other, "--json", code=1)
    assert json.loads(done.stdout)["unfinished"] == 1
    assert json.loads(archive(*other, "--keep-both", "--json").stdout)["segments"] == 2


def test_differences_and_numbers_are_written_as_a_person_would(inputs, filled):
    assert (
        _difference({"settings": {"max_error_m": None}, "seconds": 1}, {"max_error_m": 0.02}, 1) == "max_error_m=null"
    )
    done = archive("run", inputs, filled, *SHORT)
    assert done.stdout.strip() == "1 input, 1 finished before"


@pytest.mark.sweep
def test_an_input_that_was_replaced_under_its_name_is_archived_and_not_compared(inputs, filled, caplog):
    path = inputs / "car-7/roof/drive.pcap"
    path.write_bytes(path.read_bytes())  # another time of change
    done = archive("run", inputs, filled, "--job", "verify", "--workers", "here", "--json")
    assert (json.loads(done.stdout)["segments"], json.loads(done.stdout)["compared"]) == (2, 0)
    told = json.loads(archive("run", inputs, filled, *SHORT, "--json").stdout)
    assert (told["changed"], told["segments"]) == (1, 2)
    assert "changed since they were archived" in caplog.text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--job", "nothing"), "unknown job"),
        (("--workers", "dask"), "--scheduler"),
        (("--workers", "ray"), "--scheduler"),
        (("--set", "target_kbps=auto"), "only with live streams"),
        (("--job", "verify", "--codec", "zstd"), "--codec and --set are only for --job compress, recompress"),
        (("--job", "verify", "--seconds", "9"), "--seconds is only for --job compress"),
        (("--job", "index", "--processes", "2"), "runs in this process"),
        (("--workers", "here", "--processes", "2"), "--processes is only for --workers processes"),
        (("--workers", "here", "--timeout", "9"), "--timeout does not work with --workers here"),
        (("--workers", "here", "--memory", "900"), "--memory does not work with --workers here"),
        (("--job", "stats", "--memory", "900"), "runs in this process"),
        (("--job", "recompress"), "needs the new settings"),
        (("--delete-old",), "only for --job recompress"),
        (("--codec", "nothing"), "unknown codec"),
        (("--repair", "--dry-run"), "without --dry-run"),
    ],
)
def test_wrong_options_are_refused(inputs, tmp_path, words, said):
    done = run_here("archive", "run", str(inputs), str(tmp_path / "out"), *words)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_missing_extra_is_one_line(inputs, tmp_path, monkeypatch):
    monkeypatch.setattr("lidarcodec.archive.table.find_spec", lambda name: None)
    done = run_here("archive", "run", str(inputs), str(tmp_path / "out"))
    assert done.returncode == 2
    assert "pip install 'lidarcodec[archive]'" in done.stderr
