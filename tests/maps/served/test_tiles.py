"""Tiles around a position come from files and from networks alike, go on after lost links, and nothing is trusted."""

from __future__ import annotations

import hashlib
import json
import math
import threading

import numpy as np
import pytest

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.maps import open_map, read_map
from lidarcodec.maps.served import manifest as manifests
from lidarcodec.maps.served.answers import HEAD, MapAnswers
from lidarcodec.maps.served.manifest import KEY
from lidarcodec.maps.served.shelf import MapShelf
from lidarcodec.maps.served.sources import NetworkTiles, maps_on
from lidarcodec.maps.served.stores import FolderPieces, MemoryPieces
from tests.maps.served.conftest import changed, write
from tests.maps.towns import same_points
from tests.transport.test_contract import eventually


class Server:
    """Answers about a shelf through a hook that may change, delay or drop answers."""

    def __init__(self, transport, town):
        self.shelf = MapShelf([town])
        self._answers = MapAnswers(self.shelf)
        self.asked = []
        self.hook = lambda key, question, answer: answer
        transport.answer_under(f"{KEY}/**", self._answer)

    def _answer(self, key, data):
        self.asked.append(key)
        return self.hook(key, json.loads(data or b"{}"), self._answers.answer(key, data))

    def tiles_asked(self):
        return [key for key in self.asked if key.count("/") == 5]


@pytest.fixture
def server(ends, town):
    return Server(ends[0], town)


def part(server, change):
    """Have the answers of tiles changed."""
    server.hook = lambda key, question, answer: change(answer) if answer[:1] == b"\x01" else answer


@pytest.mark.parametrize("where", ["file", "network"])
def test_the_tiles_around_a_position_are_here_and_follow_it(where, ends, town, server):
    whole = read_map(town)
    with open_map(town if where == "file" else "town", radius_m=30.0, transport=ends[1]) as found:
        assert (found.name, found.head.step_m, len(found.places)) == ("town", 0.02, 10)
        assert np.array_equal(found.path, whole.path)
        assert len(found.points()) == 0
        for x in (10.0, 130.0, 215.0):
            found.move(x, 0.0)
            assert found.wait(60.0)
            near = (whole.steps[:, 0] // 2500 * 50 - 30 <= x) & (whole.steps[:, 0] // 2500 * 50 + 80 >= x)
            expected = whole.taken(near.nonzero()[0])
            here = found.points()
            xs = {tile // 2500 for tile in here.steps[:, 0]}
            assert set((expected.steps[:, 0] // 2500).tolist()) <= xs
            assert len(xs) <= 4  # and a margin, no more
            assert found.points() is here
        assert found.state().missing == 0
        assert found.state().points == len(here)


def test_the_whole_map_is_the_file(ends, town, server):
    with open_map("town", radius_m=math.inf, transport=ends[1]) as found:
        found.move(0.0, 0.0)
        assert found.wait(60.0)
        whole = read_map(town)
        assert same_points(whole, found.points())
        assert found.points().normals.shape == (len(whole), 3)


@pytest.mark.parametrize("where", ["file", "network"])
def test_only_what_changed_is_fetched_again(where, ends, town, server):
    with open_map(town if where == "file" else "town", radius_m=math.inf, transport=ends[1]) as found:
        found.move(0.0, 0.0)
        assert found.wait(60.0)
        before, serial = len(server.tiles_asked()), found.serial
        changed(town, (1, 0))
        server.shelf.refresh()
        after = read_map(town)
        assert eventually(lambda: found.wait(1.0) and len(found.points()) == len(after))
        assert same_points(after, found.points())
        assert found.serial > serial
        assert {key[-4:] for key in server.tiles_asked()[before:]} <= {"/1/0"}


def test_a_tile_goes_on_where_a_lost_link_cut_it_off(ends, town, server, tmp_path, monkeypatch):
    monkeypatch.setattr("lidarcodec.transport.part_size.MIN_PART", 100)
    tile = max(server.shelf.get("town").manifest.tiles, key=lambda one: one.size)
    assert tile.size > 200
    offsets = []

    def lossy(key, question, answer):
        if answer[:1] == b"\x01":
            offsets.append(question["offset"])
            if len(offsets) in (2, 3):
                return None
        return answer

    server.hook = lossy
    first = NetworkTiles("town", lambda: ends[1], FolderPieces(tmp_path / "cache", 1 << 20), 5.0)
    stopped = threading.Timer(0.0, lambda: eventually(lambda: len(offsets) > 4) and first.stop())
    stopped.start()
    try:
        data = first.read(tile)
    except Exception:  # stopped; the next process goes on
        second = NetworkTiles("town", lambda: ends[1], FolderPieces(tmp_path / "cache", 1 << 20), 5.0)
        data = second.read(tile)
    stopped.join()
    assert hashlib.sha256(data).hexdigest() == tile.hash
    assert offsets[:4] == [0, 100, 100, 100]
    assert offsets == sorted(offsets)


def test_what_is_in_the_cache_is_not_fetched_again_and_the_cache_has_a_limit(ends, town, server, tmp_path):
    for _ in range(2):
        with open_map("town", radius_m=math.inf, transport=ends[1], cache=tmp_path / "cache") as found:
            found.move(0.0, 0.0)
            assert found.wait(60.0)
    assert len(server.tiles_asked()) == 10
    held = sum(path.stat().st_size for path in (tmp_path / "cache").iterdir())
    limit = held // 2
    with open_map(
        "town", radius_m=math.inf, transport=ends[1], cache=tmp_path / "cache", max_cache_bytes=limit
    ) as found:
        found.move(0.0, 0.0)
        assert found.wait(60.0)
    assert sum(path.stat().st_size for path in (tmp_path / "cache").iterdir()) <= limit
    memory = MemoryPieces(250)
    for data in (b"a" * 100, b"b" * 100, b"c" * 100):
        name = hashlib.sha256(data).hexdigest()
        memory.add(name, 0, data)
        assert memory.finish(name)
    assert not memory.has(hashlib.sha256(b"a" * 100).hexdigest(), 100)


@pytest.mark.parametrize("where", ["folder", "memory"])
def test_incomplete_pieces_count_as_well_and_make_room_for_newer_ones(where, tmp_path):
    """As of tiles that are not there any more before their last bytes have come."""
    store = FolderPieces(tmp_path, 5000) if where == "folder" else MemoryPieces(5000)
    names = [hashlib.sha256(bytes([number]) * 1000).hexdigest() for number in range(30)]
    for number, name in enumerate(names):
        for offset, size in ((0, 500), (500, 490)):
            store.add(name, offset, bytes([number]) * size)
    assert [store.got(name) for name in names] == [0] * 25 + [990] * 5
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 5000
    store.add(names[29], 990, bytes([29]) * 10)
    assert store.finish(names[29])
    assert store.has(names[29], 1000)
    store.add(names[28], 500, bytes(500))
    assert not store.finish(names[28])  # its bytes do not count any more
    store.add(names[0], 0, bytes(1000))
    assert [store.got(names[number]) for number in (25, 26, 27, 0)] == [990, 990, 990, 1000]


def test_a_damaged_cache_is_fetched_again(ends, town, server, tmp_path):
    for _ in range(2):
        with open_map("town", radius_m=0.0, transport=ends[1], cache=tmp_path) as found:
            found.move(120.0, 10.0)
            assert eventually(lambda found=found: found.wait(1.0))
        for path in tmp_path.glob("*.piece"):
            path.write_bytes(bytes(path.stat().st_size))


def lies(answer):
    """Answers about tiles that are no tiles of the list."""
    size, at, name, data = *HEAD.unpack_from(answer)[1:], answer[HEAD.size :]
    return {
        "wrong bytes": answer[: HEAD.size] + bytes(len(data)),
        "too much": answer + bytes(500_000),
        "nothing": answer[: HEAD.size],
        "a byte at a time": answer[: HEAD.size + 1],
        "another offset": HEAD.pack(1, size, at + 7, name) + data,
        "another size": HEAD.pack(1, 2**32 - 1, at, name) + data,
        "another hash": HEAD.pack(1, size, at, bytes(32)) + data,
        "cut": answer[:9],
        "huge": bytes(3 << 20),
        "deep": b"[" * 100_000,
        "an error": json.dumps({"error": "no\x1b[2J" + "x" * 9000}).encode(),
        "no tile": json.dumps({"error": "gone", "field": "tile"}).encode(),
        "empty": b"",
    }


@pytest.mark.parametrize("kind", list(lies(bytes(HEAD.size))))
def test_a_server_that_lies_about_tiles_is_not_believed_and_the_error_is_one_line(kind, ends, server):
    part(server, lambda answer: lies(answer)[kind])
    tile = server.shelf.get("town").manifest.tiles[0]
    source = NetworkTiles("town", lambda: ends[1], MemoryPieces(1 << 20), 0.3)
    with pytest.raises(SourceError) as caught:
        source.read(tile)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400


HOSTILE_LISTS = [
    b"[" * 1000 + b"]" * 1000,
    b"{}",
    b"[]",
    b'{"version": 3}',
    b'{"error": {"deep": [1]}}',
    b'{"error": "too often", "retry_s": 0}',
    b'{"error": "too often", "retry_s": true}',
    {"head": "AAAA"},
    {"version": "x" * 64},
    {"places": [[0, 0, 10**12, "0" * 64]]},
    {"places": [[0, 0, 10, "0" * 64]] * 10},
    {"places": [[2**40, 0, 10, "0" * 64]]},
    {"places": [[0.5, 0, 10, "0" * 64]]},
    {"places": [[True, 0, 10, "0" * 64]]},
    {"places": [{}]},
    {"places": 7},
    {"path": [2**40, "0" * 64]},
    {"path": None},
]


@pytest.mark.parametrize("lie", HOSTILE_LISTS, ids=range(len(HOSTILE_LISTS)))
def test_lists_of_tiles_that_make_no_sense_are_refused(lie, ends, server):
    server.hook = lambda key, question, answer: (
        lie if isinstance(lie, bytes) else json.dumps(json.loads(answer) | lie).encode()
    )
    with pytest.raises(SourceError):
        open_map("town", transport=ends[1], patience_s=0.3)


def test_of_the_pages_of_a_hostile_list_only_tiles_are_kept_and_short_ones_end_it(ends, server):
    """A page of one tile and 100,000 empty lists; the second short page is refused."""
    more = ", ".join(["[]"] * 100_000)

    def hook(key, question, answer):
        at = question.get("from", 0)
        told = json.loads(answer) | {"tiles": 200_000, "places": [[at, 0, 1, "0" * 64]]}
        return f'{json.dumps(told)[:-1]}, "x": [{more}]}}'.encode()

    server.hook = hook
    with pytest.raises(SourceError, match="a page of 1 tiles"):
        open_map("town", transport=ends[1], patience_s=60.0)
    assert len(server.asked) == 2


def test_pages_come_one_after_the_other_and_a_list_that_changes_meanwhile_begins_anew(ends, server, monkeypatch):
    monkeypatch.setattr(manifests, "PAGE", 4)
    version = iter(["0" * 64])

    def hook(key, question, answer):
        told = json.loads(answer)
        return json.dumps(told | {"version": next(version, told["version"])}).encode()

    server.hook = hook
    with open_map("town", transport=ends[1], patience_s=60.0) as found:
        assert len(found.places) == 10
    assert len(server.asked) == 2 + 3


def test_tiles_that_do_not_decode_are_told_and_the_others_are_here(ends, town, server):
    shelved = server.shelf.get("town")
    bad = shelved.manifest.tiles[3]
    data = bytes(bad.size)
    name = hashlib.sha256(data).hexdigest()

    def hook(key, question, answer):
        if key == f"{KEY}/town":
            return answer.replace(bad.hash.encode(), name.encode())
        if key.endswith(bad.tail):
            return HEAD.pack(1, bad.size, question["offset"], bytes.fromhex(name)) + data[question["offset"] :]
        return answer

    server.hook = hook
    with open_map("town", radius_m=math.inf, transport=ends[1]) as found:
        found.move(0.0, 0.0)
        assert not found.wait(0.5)
        assert eventually(lambda: found.state().missing == 1 and found.state().error is not None)
        assert found.state().here == 9


def test_an_error_is_told_until_the_tile_or_the_list_is_here_again(ends, server):
    broken = True
    refused = json.dumps({"error": "the disk is broken"}).encode()
    server.hook = lambda key, question, answer: refused if broken else answer
    with pytest.raises(SourceError, match="the disk is broken"):
        open_map("town", transport=ends[1])
    broken = False
    with open_map("town", radius_m=10.0, transport=ends[1]) as found:
        broken = True
        found.move(20.0, 10.0)
        assert eventually(lambda: "the disk is broken" in (found.state().error or ""))
        broken = False
        assert eventually(lambda: found.wait(1.0))
        server.hook = lambda key, question, answer: None if key.count("/") == 5 else answer
        found.move(130.0, 10.0)
        assert eventually(lambda: found.state().waiting is not None)
        assert eventually(lambda: found.state().missing > 0 and found.state().error is None)


def test_the_path_is_waited_for_as_long_as_was_asked_and_not_beyond_the_end(ends, server):
    found = open_map("town", transport=ends[1], patience_s=1.5)
    server.hook = lambda key, question, answer: None
    with pytest.raises(SourceError, match=r"nobody answered about map 'town' for 1.5 s"):
        assert found.path is None
    found.close()
    with pytest.raises(SourceError, match="was closed"):
        assert found.path is None


def test_points_have_a_limit_and_the_nearest_tiles_are_here(ends, town):
    with open_map(town, radius_m=math.inf, max_points=1200) as found:
        found.move(0.0, 0.0)
        assert not found.wait(0.3)
        assert eventually(lambda: 0 < found.state().points <= 1200 and "more than 1,200" in (found.state().error or ""))
        assert found.points().steps[:, 0].min() < 2500


def test_a_map_that_nobody_serves_and_wrong_options_are_errors(ends, town, tmp_path):
    with pytest.raises(SourceError, match="nobody answered about map 'town'"):
        open_map("town", transport=ends[1], patience_s=0.2)
    with pytest.raises(SourceError, match="cannot be the name"):
        open_map("a/b", transport=ends[1])
    with pytest.raises(SourceError, match="No such file"):
        open_map(tmp_path / "nix.lcmap")
    for wrong in ({"radius_m": -1.0}, {"radius_m": math.nan}, {"in_flight": 0}):
        with pytest.raises(SettingsError):
            open_map(town, **wrong)
    with open_map(town, radius_m=1e200) as found:
        with pytest.raises(SettingsError, match="finite"):
            found.move(math.nan, 0.0)
        found.move(0.0, 0.0)
        assert found.wait(60.0)


def test_maps_of_all_servers_are_listed(ends, town, server, tmp_path):
    other = MapAnswers(MapShelf([write(tmp_path / "b.lcmap", 30.0)]))
    ends[0].answer_under(f"{KEY}/**", other.answer)
    ends[0].answer(KEY, lambda data: b"[[[")
    ends[0].answer(KEY, lambda data: json.dumps({"maps": [{"name": "\x1b[2J"}, {"name": 3}, 7]}).encode())
    big = {"name": "big", "version": "x" * 65}
    wide = {"name": "wide", "bounds_m": [0] * 5}
    more = {"name": "more", "x": [[]] * 1000, "points": 3}
    ends[0].answer(KEY, lambda data: json.dumps({"maps": [big, wide, more]}).encode())
    assert eventually(lambda: [one["name"] for one in maps_on(ends[1], 1.0)] == ["b", "more", "town"])
    about, more, _ = maps_on(ends[1], 1.0)
    assert tuple(about) == manifests.SUMMARY
    assert more == {"name": "more", "points": 3}
