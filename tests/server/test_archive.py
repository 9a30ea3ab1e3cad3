"""The archive of a server: found by vehicle, time and place, downloaded, played; away, damaged and full are said."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

import httpx
import numpy as np
import pytest

pytest.importorskip("duckdb", reason="needs the extra archive")

import lidarcodec
from lidarcodec.archive.archive import Archive
from lidarcodec.archive.query import Bounds, query
from lidarcodec.errors import SettingsError
from lidarcodec_server.archived import finding
from lidarcodec_server.archived.archived import Archived
from lidarcodec_server.archived.copies import Copies
from lidarcodec_server.archived.errors import FullError
from tests.command_line import run_here
from tests.drives import simulated
from tests.server.live import running
from tests.transport.test_contract import eventually

ALL = "/api/v1/archive"


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """An archive of car-7/roof: 12 frames in two segments, with poses."""
    folder = tmp_path_factory.mktemp("archive")
    roof = folder / "in" / "car-7" / "roof"
    roof.mkdir(parents=True)
    scene = "sim:city?sensor=vlp16&frames=13"
    simulated(scene, roof / "drive.pcap")
    with lidarcodec.open_source(scene) as source:
        start = next(iter(source.packets())).stamp_ns
        stamps = np.arange(start, start + 2 * 10**9, 10**8)
        poses = np.stack([source.poses.at(int(stamp)) for stamp in stamps])
    np.savez(roof / "drive_poses.npz", T_world_velo=poses, velo_mid=stamps * 1e-9, stamps_ns=stamps)
    done = run_here("archive", "run", str(folder / "in"), str(folder / "out"), "--workers", "here", "--seconds", "1")
    assert done.returncode == 0, done.stderr
    return folder / "out"


@pytest.fixture(scope="module")
def there(made, tmp_path_factory):
    """A server with that archive, and its client."""
    with running(tmp_path_factory.mktemp("server"), archive=str(made)) as server:
        server.hub.linger_s = 0.2
        with httpx.Client(base_url=server.url, timeout=30) as client:
            yield server, client


def listed(client, **which):
    answer = client.get(ALL, params=which)
    assert answer.status_code == 200, answer.text
    return answer.json()["segments"]


def test_segments_are_found_by_vehicle_time_and_place(there, made):
    _, client = there
    new, old = listed(client)
    assert (new["vehicle"], new["sensor"], new["codec"], new["playing"]) == ("car-7", "roof", "pcodec", None)
    assert old["end"] < new["begin"]
    assert new["bytes"] > 1000
    sql = f"select count(*), arg_max(x, stamp_ns), arg_max(y, stamp_ns) from frames where segment = '{new['segment']}'"
    ((frames, x, y),) = Archive(made).query(sql)[1]
    assert new["frames"] == frames
    assert listed(client, vehicle="car-8") == listed(client, sensor="front") == []
    assert listed(client, **{"from": new["begin"]}) == [new]
    assert listed(client, to=old["end"], vehicle="car-7", sensor="roof") == [old]
    assert listed(client, around=f"{x},{y}", radius=0.01) == [new]
    assert listed(client, around="1e7,1e7", radius=5) == []


def test_the_list_goes_on_where_an_answer_ended(there):
    _, client = there
    new, old = listed(client)
    first = client.get(ALL, params={"limit": 1}).json()
    assert first["segments"] == [new]
    second = client.get(ALL, params={"limit": 1, "after": first["next"]}).json()
    assert second == {"segments": [old], "next": None, "lost": 0}


@pytest.mark.parametrize(
    ("which", "field"),
    [({"from": "noon"}, "from"), ({"around": "1"}, "around"), ({"around": "nan,1"}, "around"),
     ({"after": "1-x"}, "after"), ({"from": "9", "to": "8"}, "from"), ({"vehicle": "a'b"}, "vehicle"),
     ({"limit": 100000}, "limit")],
)  # fmt: skip
def test_wrong_questions_are_refused_with_their_field(there, which, field):
    _, client = there
    answer = client.get(ALL, params=which)
    assert (answer.status_code, answer.json()["field"]) == (422, field)


def test_a_download_is_the_recording_and_goes_on_after_a_cut(there, made, tmp_path):
    server, client = there
    new, _ = listed(client)
    path = f"{ALL}/{new['segment']}/download"
    whole = client.get(path)
    assert whole.content == (made / new["object"]).read_bytes()
    (tmp_path / "got.mcap").write_bytes(whole.content)
    assert len(list(lidarcodec.read_frames(tmp_path / "got.mcap"))) == new["frames"]
    rest = client.get(path, headers={"Range": "bytes=1000-", "If-Range": whole.headers["etag"]})
    assert (rest.status_code, rest.content) == (206, whole.content[1000:])
    assert eventually(lambda: not server.app.state.archived._copies._used.total())
    for name, status in (("0" * 24, 404), ("..%2f..%2fetc", 404), ("x", 422)):
        assert client.get(f"{ALL}/{name}/download").status_code == status


def test_a_segment_is_played_held_and_stopped_and_the_audit_log_says_so(there):
    server, client = there
    _, old = listed(client)
    answer = client.post(f"{ALL}/{old['segment']}/play", json={"vehicle": "past", "loop": True})
    assert answer.status_code == 201, answer.text
    assert (answer.json()["vehicle"], answer.json()["sensor"]) == ("past", "roof")
    assert server.seen("past/roof")
    assert listed(client)[1]["playing"]["loop"] is True
    assert client.post(f"{ALL}/{old['segment']}/play", json={"vehicle": "other"}).status_code == 409
    playing = f"/api/v1/recordings/{old['segment']}/play"
    assert client.patch(playing, json={"paused": True}).json()["paused"] is True
    assert client.get(playing).json()["paused"] is True
    assert client.delete(playing).status_code == 204
    assert eventually(lambda: listed(client)[1]["playing"] is None)
    assert client.get(playing).json() is None
    entries = client.get("/api/v1/audit").json()
    assert any(one["action"] == "play" and one["changes"].get("segment") == old["segment"] for one in entries)
    assert client.post(f"{ALL}/{'0' * 24}/play").status_code == 404


def test_away_and_damaged_archives_are_reported_without_their_address(made, tmp_path):
    folder = Path(shutil.copytree(made, tmp_path / "out"))
    with running(tmp_path, archive=str(folder)) as server, httpx.Client(base_url=server.url, timeout=30) as client:
        new, old = listed(client)
        recording = folder / new["object"]
        recording.write_bytes(recording.read_bytes()[:-1] + b"?")
        (folder / old["object"]).unlink()
        for one in (new, old):
            answer = client.get(f"{ALL}/{one['segment']}/download")
            assert (answer.status_code, answer.json()["type"]) == (507, "urn:lidarcodec:problem:archive-damaged")
        for table in folder.glob("frames/*/*/*.parquet"):
            table.write_bytes(b"PAR1" + bytes(100))
        answer = client.get(ALL)
        assert (answer.status_code, answer.json()["type"]) == (507, "urn:lidarcodec:problem:archive-damaged")
        folder.rename(tmp_path / "away")
        answer = client.get(ALL)
        assert (answer.status_code, answer.json()["type"]) == (503, "urn:lidarcodec:problem:archive-away")
        assert str(tmp_path) not in answer.text


def test_segments_whose_tables_are_lost_are_counted_and_logged_once_a_second(made, tmp_path, caplog):
    folder = Path(shutil.copytree(made, tmp_path / "out"))
    for joined in folder.glob("index/*"):
        joined.unlink()
    sorted(folder.glob("frames/*/*/*.parquet"))[0].unlink()
    with running(tmp_path, archive=str(folder)) as server, httpx.Client(base_url=server.url, timeout=30) as client:
        answers = [client.get(ALL).json() for _ in range(3)]
        assert [(len(one["segments"]), one["lost"]) for one in answers] == [(1, 1)] * 3
    assert 1 <= caplog.text.count("1 segments have lost their tables") < 3
    done = run_here("archive", "query", str(folder), "select count(*) from frames", "--json")
    assert json.loads(done.stdout)["lost"] == 1
    done = run_here("archive", "run", str(folder), str(folder), "--job", "stats", "--json")
    assert json.loads(done.stdout)["lost"] == 1


async def test_a_server_without_an_archive_says_so(serving, tmp_path):
    async with serving() as client:
        answer = await client.get(ALL)
        assert (answer.status_code, answer.json()["type"]) == (404, "urn:lidarcodec:problem:no-archive")
    with pytest.raises(SettingsError, match="no folder"):
        async with serving(archive=str(tmp_path / "none")):
            pass


async def test_copies_are_bounded_and_go_when_room_is_needed(made):
    archive = Archive(made)
    (_, rows) = archive.query("select distinct segment from frames order by 1")
    (one,), (other,) = rows
    sizes = [path.stat().st_size for path in made.glob("recordings/*/*/*.mcap")]
    archived = Archived(archive, Copies(archive, max_bytes=max(sizes), min_free_bytes=0))
    try:
        path, give_back = await archived.borrow(one)
        with pytest.raises(FullError):
            await archived.borrow(other)
        assert path.exists()
        give_back()
        (await archived.borrow(other))[1]()
        assert not path.exists()
    finally:
        archived.close()
    assert not path.parent.exists()


def test_a_query_ends_when_its_time_is_over_and_takes_no_more_memory_than_it_may(made):
    store = Archive(made).store
    begun_s = time.monotonic()
    with pytest.raises(TimeoutError):
        query(store, "select count(*) from range(10000000000) a, range(100000) b", Bounds(0.2, 100))
    assert time.monotonic() - begun_s < 30
    with pytest.raises(SettingsError, match="ask for less"):
        query(store, "select list(range) from range(100000000)", Bounds(30.0, 50))


def test_a_search_over_its_memory_is_no_damaged_archive(made, monkeypatch):
    monkeypatch.setattr(finding, "BOUNDS", Bounds(10.0, 1))
    with pytest.raises(SettingsError, match="ask for less"):
        finding.find(Archive(made), finding.Wanted())
    monkeypatch.setattr(finding, "BOUNDS", Bounds(10.0, 512))
    assert len(finding.find(Archive(made), finding.Wanted()).segments) == 2
