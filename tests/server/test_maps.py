"""Maps over REST and to vehicles: lists, tiles with ETags, points for the page, problems, and changes of files."""

from __future__ import annotations

import gzip
import hashlib

import numpy as np
import pytest

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.maps import read_map
from lidarcodec.maps.file import MapReader, MapWriter
from lidarcodec.maps.served.shelf import ShelvedMap
from lidarcodec.maps.served.sources import NetworkTiles, maps_on
from lidarcodec.maps.served.stores import MemoryPieces
from lidarcodec.maps.tiles import points_in
from lidarcodec_server.app import create_app
from lidarcodec_server.map_points import TilePoints
from lidarcodec_server.store.store import Store
from lidarcodec_server.tokens import create_token
from tests.maps.served.conftest import changed, write

MAPS = "/api/v1/maps"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "maps").mkdir()
    write(tmp_path / "maps" / "town.lcmap")
    return tmp_path / "maps"


async def test_maps_and_their_tiles_come_with_tags_and_are_not_sent_twice(serving, folder):
    async with serving(maps=folder) as client:
        (about,) = (await client.get(MAPS)).json()
        answer = await client.get(f"{MAPS}/town")
        manifest = answer.json()
        assert about == {name: manifest[name] for name in about}
        assert (len(manifest["places"]), manifest["next"]) == (10, None)
        assert answer.headers["etag"] == f'"{about["version"]}"'
        for one in manifest["places"]:
            path = f"{MAPS}/town/{one['x']}/{one['y']}"
            tile = await client.get(path)
            assert tile.headers["content-type"] == "application/octet-stream"
            assert tile.headers["etag"] == f'"{one["hash"]}"'
            assert hashlib.sha256(tile.content).hexdigest() == one["hash"]
            for had in (tile.headers["etag"], f'"x", W/{tile.headers["etag"]}', "*"):
                again = await client.get(path, headers={"If-None-Match": had})
                assert (again.status_code, again.content) == (304, b"")
            other = await client.get(path, headers={"If-None-Match": '"x"'})
            assert other.status_code == 200
        had = await client.get(f"{MAPS}/town", headers={"If-None-Match": answer.headers["etag"]})
        assert had.status_code == 304


async def test_only_tiles_near_a_place_are_listed(serving, folder):
    async with serving(maps=folder) as client:
        near = (await client.get(f"{MAPS}/town", params={"x": 10, "y": 0, "radius": 30})).json()
        assert {one["x"] for one in near["places"]} == {0}
        half = await client.get(f"{MAPS}/town", params={"x": 10})
        assert (half.status_code, half.json()["field"]) == (422, "y")
        assert (await client.get(f"{MAPS}/town", params={"x": "nan", "y": 0})).status_code == 422
        every = (await client.get(f"{MAPS}/town")).json()["places"]
        assert (await client.get(f"{MAPS}/town", params={"from": 8})).json()["places"] == every[8:]


async def test_points_of_all_tiles_are_those_of_the_map(serving, folder):
    points = read_map(folder / "town.lcmap")
    async with serving(maps=folder) as client:
        found = []
        for one in (await client.get(f"{MAPS}/town")).json()["places"]:
            path = f"{MAPS}/town/{one['x']}/{one['y']}"
            for accepted in ("gzip", "identity"):
                answer = await client.get(path, params={"form": "points"}, headers={"Accept-Encoding": accepted})
                assert (answer.headers.get("content-encoding") == "gzip") == (accepted == "gzip")
                xyz = np.frombuffer(answer.content, "<f4").reshape(-1, 3)
            assert answer.headers["etag"] != f'"{one["hash"]}"'
            found.append(xyz + np.array([one["x"] * 50, one["y"] * 50, 0]))
        steps = np.rint(np.concatenate(found) / points.step_m).astype(np.int64)
        assert {tuple(one) for one in steps.tolist()} == {tuple(one) for one in points.steps.tolist()}


async def test_what_is_not_there_or_makes_no_sense_is_a_problem(serving, folder):
    async with serving(maps=folder) as client:
        for path, status, name in (
            (f"{MAPS}/nix", 404, "unknown-map"),
            (f"{MAPS}/nix/0/0", 404, "unknown-map"),
            (f"{MAPS}/town/99/0", 404, "unknown-tile"),
            (f"{MAPS}/town/x/0", 422, "request"),
            (f"{MAPS}/town/99999999999/0", 422, "request"),
            (f"{MAPS}/town/0/0?form=mesh", 422, "request"),
            (f"{MAPS}/a%20b", 422, "request"),
        ):
            answer = await client.get(path)
            assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json"), path
            assert answer.json()["type"].endswith(name)
        assert (await client.post(f"{MAPS}/town", json={})).status_code == 405
    async with serving() as client:
        assert (await client.get(MAPS)).json() == []
    with pytest.raises(SettingsError, match="neither a map"):
        create_app(client.app.state.config.model_copy(update={"maps": folder / "nix"}))


async def test_a_map_that_changed_is_served_from_then_on_and_a_broken_one_is_a_problem(serving, folder):
    async with serving(maps=folder) as client:
        shelf = client.app.state.service.maps
        before = (await client.get(f"{MAPS}/town/1/0")).headers["etag"]
        changed(folder / "town.lcmap", (1, 0))
        shelf.refresh()
        after = await client.get(f"{MAPS}/town/1/0", headers={"If-None-Match": before})
        assert after.status_code == 200
        assert after.headers["etag"] != before
        with (folder / "town.lcmap").open("r+b") as file:
            file.truncate(200)
        for form in ("tile", "points"):
            cut = await client.get(f"{MAPS}/town/2/0", params={"form": form})
            assert (cut.status_code, cut.json()["type"]) == (507, "urn:lidarcodec:problem:storage")


async def test_readers_read_maps_and_strangers_do_not(serving, folder, config):
    store = Store(config.database_url)
    store.open()
    token = create_token(store, "anna", "viewer")
    store.close()
    async with serving(maps=folder) as client:
        for path in (MAPS, f"{MAPS}/town", f"{MAPS}/town/0/0"):
            assert (await client.get(path)).status_code == 401
            answer = await client.get(path, headers={"Authorization": f"Bearer {token}"})
            assert answer.status_code == 200


async def test_vehicles_get_the_same_maps(serving, folder, network):
    async with serving(maps=folder):
        with network.transport() as vehicle:
            assert [one["name"] for one in maps_on(vehicle)] == ["town"]
            source = NetworkTiles("town", lambda: vehicle, MemoryPieces(1 << 20), 5.0)
            tile = source.manifest().tiles[0]
            assert hashlib.sha256(source.read(tile)).hexdigest() == tile.hash


def test_a_tile_of_another_place_is_not_drawn(folder):
    """The page drew it where the index of the file says; `localise` and `map export` refuse it."""
    with MapReader.open(folder / "town.lcmap") as town, (folder / "moved.lcmap").open("w+b") as file:
        writer = MapWriter(file, town.head)
        for at, other in zip(town.places[:2], town.places[1::-1], strict=True):
            with (folder / "town.lcmap").open("rb") as original:
                original.seek(other.offset)
                data = original.read(other.size)
            writer.append(at.x, at.y, data, points_in(data))
        writer.close(town.path, town.length_m)
    town, moved = (ShelvedMap(name, folder / f"{name}.lcmap") for name in ("town", "moved"))
    drawn = TilePoints()
    for tile in town.manifest.tiles[:2]:
        drawn.packed(town, tile)  # what is kept of it is of its place alone
    for tile in moved.manifest.tiles:
        for points in (TilePoints(), drawn):
            with pytest.raises(SourceError, match="the tile of another place"):
                points.packed(moved, tile)


def test_a_tile_that_cannot_be_drawn_is_not_decoded_again_and_again(folder):
    """A page asks every ten seconds, and a tile of a million points took three seconds of processor each time."""
    with MapReader.open(folder / "town.lcmap") as town:
        (place, *_) = town.places
    data = bytearray((folder / "town.lcmap").read_bytes())
    data[place.offset + place.size - 1] ^= 1
    (folder / "bad.lcmap").write_bytes(data)
    reads = []

    class Counted(ShelvedMap):
        def read(self, piece, offset=0, size=None):
            reads.append(piece)
            return super().read(piece, offset, size)

    bad, drawn = Counted("bad", folder / "bad.lcmap"), TilePoints()
    for _ in range(3):
        with pytest.raises(SourceError, match="of map 'bad' is damaged: the checksum"):
            drawn.packed(bad, bad.pieces[place.x, place.y])
    assert len(reads) == 1
    (other,) = (one for one in bad.manifest.tiles[1:2])
    assert drawn.packed(bad, other)


def test_a_map_that_is_copied_over_another_one_is_not_taken_for_damaged(folder):
    """`cp` writes into the file that is served. A tile that was asked for meanwhile was gone until a restart, even if
    the new map has the same one; and bytes of another map came with its ETag."""
    town = folder / "town.lcmap"
    whole = town.read_bytes()
    shelved, drawn = ShelvedMap("town", town), TilePoints()
    tile = shelved.manifest.tiles[0]
    with town.open("r+b") as file:
        file.write(bytes(len(whole)))
    for read in (shelved.read, lambda asked: drawn.packed(shelved, asked)):
        with pytest.raises(SourceError, match="was overwritten while it was served"):
            read(tile)
    with town.open("r+b") as file:
        file.write(whole)
    assert drawn.packed(shelved, tile)


def test_points_are_thinned_where_there_are_too_many(folder, monkeypatch):
    from lidarcodec.maps.served.shelf import MapShelf
    from lidarcodec_server import map_points

    shelved = MapShelf([folder]).get("town")
    tile = shelved.manifest.tiles[0]
    every = gzip.decompress(map_points.TilePoints().packed(shelved, tile))
    monkeypatch.setattr(map_points, "MOST_DRAWN", len(every) // 12 // 3)
    few = gzip.decompress(map_points.TilePoints().packed(shelved, tile))
    assert len(every) // 4 - 12 <= len(few) <= len(every) // 3
