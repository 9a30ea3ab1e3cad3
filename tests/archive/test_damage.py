"""What an archive does about damage, loss and requests that mean harm: it says so, and gives nothing away as whole."""

from __future__ import annotations

import json
import shutil

import pytest

import lidarcodec
from lidarcodec.archive.archive import open_archive
from lidarcodec.archive.contents import commits_of
from lidarcodec.archive.index import index, tables_to_read
from lidarcodec.archive.objects import places_of, read_commit
from lidarcodec.archive.repair import repair
from lidarcodec.archive.stores.folder import FolderStore
from lidarcodec.wire.checksum import with_checksum
from tests.archive.conftest import FRAMES, SHORT, archive, objects


def test_a_commit_whose_messages_lie_over_each_other_is_damaged(filled):
    """Each would be read and decoded as often as there are others."""
    commit = next((filled / "commits").rglob("*.json"))
    told = json.loads(commit.read_text())
    commit.write_text(json.dumps(told | {"messages": [told["messages"][0]] * len(told["messages"])}))
    with pytest.raises(lidarcodec.errors.SourceError, match="overlaps the one before it"):
        list(open_archive(filled).frames())


def test_repair_keeps_what_a_commit_that_cannot_be_read_stands_for(inputs, filled, caplog):
    """It may be of a newer version, and its input may be gone."""
    commit = next((filled / "commits").rglob("*.json"))
    commit.write_text(commit.read_text().replace('"format":1', '"format":2'))
    before = objects(filled)
    archive("run", inputs, filled, *SHORT, "--repair")
    assert "was left unchanged" in caplog.text
    assert objects(filled) == before


def test_what_is_broken_is_reported_at_each_run(inputs, filled):
    recording = next((filled / "recordings").rglob("*.mcap"))
    recording.write_bytes(recording.read_bytes()[:-100])
    for _ in range(2):
        assert "BROKEN" in archive("run", inputs, filled, "--job", "verify", "--workers", "here", code=1).stdout


def test_a_condition_that_could_not_see_all_segments_is_no_success(filled, tmp_path):
    """Their frames were missing, and the exit code was 0."""
    next((filled / "frames").rglob("*.parquet")).unlink()
    done = archive("get", filled, tmp_path / "some.mcap", "--where", "points >= 0", code=1)
    assert "could not see those of 1 segment whose tables are lost" in done.stderr
    assert (tmp_path / "some.mcap").exists()
    archive("get", filled, tmp_path / "all.mcap")


def test_a_query_or_table_of_numbers_that_lacks_segments_is_no_success(inputs, filled, tmp_path):
    """What counted the frames of a fleet said a smaller number, and 0 to the shell."""
    next((filled / "frames").rglob("*.parquet")).unlink()
    done = archive("query", filled, "select count(*) from frames", "--json", code=1)
    assert json.loads(done.stdout)["lost"] == 1
    assert "the answer lacks 1 segment whose tables are lost" in done.stderr
    told = json.loads(archive("run", inputs, filled, "--job", "stats", "--json", code=1).stdout)
    assert (told["lost"], len(told["stats"])) == (1, 1)
    done = archive("run", filled, tmp_path / "maps", "--job", "map", "--workers", "here", "--json", code=1)
    assert json.loads(done.stdout)["lost"] == 1


def test_repair_removes_what_was_never_finished_and_makes_lost_objects_again(inputs, filled):
    before = objects(filled)
    (filled / "recordings/car-7/roof" / f"{'0' * 24}-{'0' * 16}.mcap").write_bytes(b"never committed")
    (filled / "recordings" / f".half.{'0' * 12}.mcap").write_bytes(b"half")
    next(filled.rglob("*.parquet")).unlink()
    archive("run", inputs, filled, *SHORT, "--repair")
    assert objects(filled) == before


def test_repair_keeps_what_is_damaged_and_cannot_be_made_again(inputs, filled, caplog):
    recording = next((filled / "recordings").rglob("*.mcap"))
    recording.write_bytes(recording.read_bytes()[:-100])
    before = objects(filled)
    shutil.move(inputs / "car-7", inputs.parent / "car-7")
    assert not repair(FolderStore(filled), FolderStore(inputs))
    assert objects(filled) == before
    assert "is damaged, and its input no longer exists" in caplog.text
    shutil.move(inputs.parent / "car-7", inputs)
    assert repair(FolderStore(filled), FolderStore(inputs)) == {"lost": 1, "unfinished": 2}


def test_what_is_lost_after_it_was_replaced_is_made_again(inputs, filled):
    before = objects(filled)
    words = ("--job", "recompress", "--codec", "raw", "--delete-old", "--workers", "here")
    archive("run", filled, filled, *words)
    for path in (filled / "recordings").rglob("*.mcap"):
        path.unlink()
    told = json.loads(archive("run", inputs, filled, *SHORT, "--repair", "--json").stdout)
    assert (told["repaired"]["lost"], told["segments"]) == (4, 2)
    assert objects(filled) == before


@pytest.mark.parametrize("cut", [True, False])
def test_a_damaged_joined_table_ends_no_query_and_is_made_again(filled, monkeypatch, caplog, cut):
    monkeypatch.setattr("lidarcodec.archive.index.FAN_IN", 2)
    store, rows = FolderStore(filled), "select * from frames order by stamp_ns"
    before = open_archive(filled).query(rows)
    index(store)
    (path,) = (filled / "index").glob("*.parquet")
    whole = path.read_bytes()
    path.write_bytes(whole[:-2000] if cut else whole[:-8] + bytes(8))
    assert open_archive(filled).query(rows) == before
    assert ("has another size" if cut else "joined tables were not used") in caplog.text
    assert index(store) == {"joined": 1, "removed": 1}
    assert path.read_bytes() == whole
    assert tables_to_read(store).names == [f"index/{path.name}"]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("COPY (SELECT 'mine') TO '{file}' (FORMAT csv)", "must be a single SELECT"),
        ("EXPLAIN ANALYZE COPY (SELECT 'mine') TO '{file}' (FORMAT csv)", "must be a single SELECT"),
        ("SELECT 1; COPY (SELECT 'mine') TO '{file}' (FORMAT csv)", "must be a single SELECT"),
        ("LOAD '{file}'", "must be a single SELECT"),
        ("SELECT * FROM read_text('{file}')", "file system operations are disabled"),
        ("SELECT * FROM '{file}'", "cannot be run"),
    ],
)
def test_a_query_or_condition_from_elsewhere_touches_no_file_but_the_tables(filled, tmp_path, asked, said):
    file = tmp_path / "mine.csv"
    file.write_text("precious")
    sql = asked.format(file=file)
    assert said in archive("query", filled, sql, code=2).stderr
    inside = f"1=1); {sql}; SELECT segment, 1 FROM frames WHERE (1=1"
    where = f"exists ({sql})" if sql.startswith("SELECT *") else inside
    assert said in archive("get", filled, tmp_path / "out.mcap", "--where", where, code=2).stderr
    assert file.read_text() == "precious"
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize(("sealed", "said"), [(False, "checksum should be"), (True, "another message at byte")])
def test_a_stored_message_that_changed_is_not_given_away_as_whole(filled, tmp_path, sealed, said):
    store = FolderStore(filled)
    value = read_commit(store, commits_of(store)[0])
    place, path = places_of(value)[1], filled / value["object"]
    data = bytearray(path.read_bytes())
    message = data[place.offset : place.offset + place.length]
    message[place.length // 2] ^= 1
    data[place.offset : place.offset + place.length] = with_checksum(bytes(message[:-4])) if sealed else message
    path.write_bytes(data)
    for out in ("out.mcap", "out.pcap"):
        assert said in archive("get", filled, tmp_path / out, code=1).stderr
        assert not (tmp_path / out).exists()


@pytest.mark.parametrize("told", [None, 1])
def test_a_commit_that_lacks_messages_does_not_pass_for_whole(filled, tmp_path, told):
    path = next((filled / "commits").rglob("*.json"))
    value = json.loads(path.read_bytes())
    value["messages"] = value["messages"][:1]
    value["frames"] = told or value["frames"]
    path.write_text(json.dumps(value))
    done = archive("get", filled, tmp_path / "out.mcap", "--where", "points >= 0", code=1)
    assert ("does not have all messages" if told else "its messages have only 1 of") in done.stderr
    assert not (tmp_path / "out.mcap").exists()


def test_a_lost_table_ends_no_query_of_the_others(filled, caplog):
    lost = next((filled / "frames").rglob("*.parquet"))
    gone = open_archive(filled).query(f"select count(*) from read_parquet('{lost}')")[1][0][0]
    lost.unlink()
    assert open_archive(filled).query("select count(*) from frames")[1] == [(FRAMES - gone,)]
    assert (
        f"1 segments have lost their tables, so their frames are missing here: car-7/roof/{lost.name[:24]}"
        in caplog.text
    )


def test_a_damaged_plan_is_no_end_of_a_run(inputs, filled, caplog):
    next((filled / "commits").rglob("*.json")).unlink()
    next((filled / "plans").iterdir()).write_text('{"segments": [{"first": 1e9}]}')
    assert json.loads(archive("run", inputs, filled, *SHORT, "--json").stdout)["segments"] == 1
    assert "is damaged" in caplog.text
