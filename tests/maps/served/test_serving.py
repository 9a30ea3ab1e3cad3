"""A shelf knows the maps of its files as they are now, and answers about them, hostile questions too."""

from __future__ import annotations

import hashlib
import json

import pytest

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.maps.file import MapReader
from lidarcodec.maps.served import manifest as manifests
from lidarcodec.maps.served.answers import HEAD, MapAnswers
from lidarcodec.maps.served.manifest import KEY, manifest_of
from lidarcodec.maps.served.shelf import MapShelf
from lidarcodec.maps.tiles import decode_tile
from tests.maps.served.conftest import changed, write


def asked(answers, tail, **question):
    answer = answers.answer(f"{KEY}{tail}", json.dumps(question).encode())
    return answer if answer is None or answer[:1] == b"\x01" else json.loads(answer)


def test_a_list_a_manifest_and_all_tiles_say_what_the_file_holds(town):
    answers = MapAnswers(MapShelf([town]))
    (about,) = asked(answers, "")["maps"]
    page = asked(answers, "/town")
    assert about == {name: page[name] for name in about}
    assert about["version"] == hashlib.sha256(town.read_bytes()).hexdigest()
    assert about["bounds_m"] == [0, -50, 250, 50]
    manifest = manifest_of("town", [page])
    with MapReader.open(town) as reader:
        assert [tile.place for tile in manifest.tiles] == [(place.x, place.y) for place in reader.places]
        assert sum(tile.size for tile in manifest.tiles) + manifest.path.size == manifest.size
        for tile in manifest.tiles:
            answer = asked(answers, f"/town/{tile.tail}")
            data = answer[HEAD.size :]
            assert HEAD.unpack_from(answer) == (1, len(data), 0, bytes.fromhex(tile.hash))
            assert hashlib.sha256(data).hexdigest() == tile.hash
            found = decode_tile(data, reader.head.width, reader.head.bits)
            assert (found.x, found.y) == tile.place


def test_whoever_has_a_tile_or_the_list_is_told_that_it_is_the_same(town):
    answers = MapAnswers(MapShelf([town]))
    page = asked(answers, "/town")
    x, y, size, name = page["places"][0]
    assert asked(answers, "/town", have=page["version"]) == {"name": "town", "version": page["version"], "same": True}
    assert asked(answers, f"/town/{x}/{y}", have=name) == {"same": True, "hash": name}
    part = asked(answers, f"/town/{x}/{y}", hash=name, offset=size - 10, bytes=4)
    assert HEAD.unpack_from(part)[1:3] == (size, size - 10)
    assert len(part) == HEAD.size + 4


def test_a_map_that_changed_is_served_from_then_on_and_a_tile_that_changed_begins_anew(town):
    shelf = MapShelf([town])
    answers = MapAnswers(shelf)
    before = shelf.get("town").manifest
    changed(town, (1, 0))
    shelf.refresh()
    after = shelf.get("town").manifest
    differing = {tile.place for tile in set(before.tiles) ^ set(after.tiles)}
    assert differing == {(1, 0)}
    old = next(tile for tile in before.tiles if tile.place == (1, 0))
    new = next(tile for tile in after.tiles if tile.place == (1, 0))
    answer = asked(answers, "/town/1/0", hash=old.hash, offset=40, bytes=50)
    assert HEAD.unpack_from(answer) == (1, new.size, 0, bytes.fromhex(new.hash))
    assert asked(answers, "/town/1/0", have=old.hash)[:1] == b"\x01"


def test_a_file_that_is_damaged_or_gone_is_noticed_and_the_map_before_stays_while_there_is_a_file(town, caplog):
    shelf = MapShelf([town])
    before = shelf.get("town")
    other = town.with_name("other.lcmap")
    other.write_bytes(town.read_bytes()[:-10])
    other.rename(town)
    shelf.refresh()
    shelf.refresh()
    assert shelf.get("town") is before
    tile = before.manifest.tiles[0]
    assert hashlib.sha256(before.read(tile)).hexdigest() == tile.hash  # the old file is still open
    assert len([line for line in caplog.messages if "still served" in line]) == 1
    town.unlink()
    shelf.refresh()
    assert shelf.get("town") is None


def test_a_folder_gains_maps_and_leaves_out_what_is_none(tmp_path):
    shelf = MapShelf([tmp_path])
    assert shelf.all() == []
    write(tmp_path / "a.lcmap", 30.0)
    (tmp_path / "b.lcmap").write_bytes(b"no map")
    (tmp_path / ".c.lcmap").write_bytes(b"being written")
    (tmp_path / "d e.lcmap").write_bytes((tmp_path / "a.lcmap").read_bytes())
    shelf.refresh()
    assert [one.name for one in shelf.all()] == ["a"]


def test_files_that_are_no_maps_are_refused_at_once(tmp_path, town):
    with pytest.raises(SettingsError, match="neither a map"):
        MapShelf([tmp_path / "town.mcap"])
    with pytest.raises(SourceError, match="No such file"):
        MapShelf([tmp_path / "nix.lcmap"])
    (tmp_path / "deeper").mkdir()
    twin = write(tmp_path / "deeper" / "town.lcmap", 30.0)
    with pytest.raises(SettingsError, match="two maps have the name"):
        MapShelf([town, twin])


@pytest.mark.parametrize(
    ("tail", "data", "reason"),
    [
        ("/town/x/y", b"", "neither a tile"),
        ("/town/1", b"", "neither a tile"),
        ("/town/1/2/3", b"", "neither a tile"),
        ("/town/99/99", b"", "no tile 99/99"),
        ("/town/" + "9" * 100 + "/1", b"", "neither a tile"),
        ("/town/0/0", b"[" * 100 + b"]" * 100, "nested more than"),
        ("/town/0/0", b'{"hash": 3}', "64 hexadecimal digits"),
        ("/town/0/0", b'{"offset": 1e9}', "whole number"),
        ("/town/0/0", b'{"offset": 99999999}', "the tile has"),
        ("/town/0/0", b'{"offset": -1}', "whole number"),
        ("/town", b'{"from": "x"}', "whole number"),
        ("/town", b"{", "malformed"),
        ("", b"\xff", "malformed"),
    ],
)
def test_questions_that_make_no_sense_get_an_error(town, tail, data, reason):
    answers = MapAnswers(MapShelf([town]))
    assert reason in json.loads(answers.answer(f"{KEY}{tail}", data))["error"]


def test_names_of_others_are_left_to_others_and_lists_have_a_rate_limit(town):
    answers = MapAnswers(MapShelf([town]))
    assert answers.answer(f"{KEY}/other/0/0", b"") is None
    told = [asked(answers, "") for _ in range(150)]
    assert 0 < told[-1]["retry_s"] < 1
    assert "maps" in told[0]
    assert asked(answers, "/town/0/0")[:1] == b"\x01"  # parts are not limited


def test_long_lists_come_in_pages(town, monkeypatch):
    monkeypatch.setattr(manifests, "PAGE", 2)
    answers = MapAnswers(MapShelf([town]))
    pages = [asked(answers, "/town", **{"from": at}) for at in range(0, 12, 2)]
    assert [len(page["places"]) for page in pages] == [2, 2, 2, 2, 2, 0]
    assert manifest_of("town", pages) == MapShelf([town]).get("town").manifest
