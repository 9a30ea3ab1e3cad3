"""`map fetch` writes only maps that are those of the list, and says what is not served without guessing."""

import threading
from dataclasses import replace
from io import BytesIO

import pytest

from lidarcodec.commands.map import serve
from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.maps.served.answers import MapAnswers
from lidarcodec.maps.served.fetching import write_fetched
from lidarcodec.maps.served.manifest import KEY
from lidarcodec.maps.served.shelf import MapShelf, ShelvedMap
from tests.maps.served.conftest import write


def test_a_fetched_map_is_refused_if_it_is_not_the_one_of_the_list(town):
    shelved = ShelvedMap("town", town)
    whole = shelved.manifest
    one, two, *rest = whole.tiles

    def written(tiles, pieces, manifest=whole):
        file = BytesIO()
        write_fetched(file, manifest, tiles, lambda piece: pieces.get(piece.place) or shelved.read(piece))
        return file.getvalue()

    assert written(list(whole.tiles), {}) == town.read_bytes()
    for pieces, tiles, manifest, reason in (
        ({one.place: shelved.read(two), two.place: shelved.read(one)}, [one, two], whole, "another place"),
        ({one.place: b"garbage!"}, [one, two], whole, f"tile {one.tail} of map 'town' is damaged"),
        ({None: b"garbage!"}, [one, two], whole, "the path of map 'town' is damaged"),
        ({None: shelved.read(whole.path)[:-5]}, [one, two], whole, "the path of map 'town' is damaged"),
        ({}, [two, one, *rest], whole, "do not match its list"),
        ({}, list(whole.tiles), replace(whole, about=whole.about._replace(length_m=1.0)), "do not match its list"),
    ):
        with pytest.raises(SourceError, match=reason):
            written(tiles, pieces, manifest)


def test_a_map_is_unknown_only_if_others_are_served_and_nobody_answers_twice(ends, town, tmp_path, monkeypatch):
    """The server of the town is slow: it answers neither the list nor the first question."""
    monkeypatch.setattr(serve, "AGREED_S", 0.01)
    monkeypatch.setattr(serve, "ANSWER_S", 0.5)
    monkeypatch.setattr(serve, "LIST_S", 0.1)
    server, vehicle = ends
    serve.check_served(vehicle, "town", threading.Event())  # nobody says anything: there may be no link
    MapAnswers(MapShelf([write(tmp_path / "b.lcmap", 30.0)])).declare(server)
    slow, asked = MapAnswers(MapShelf([town])), []

    def answer(key, data):
        asked.append(key)
        return slow.answer(key, data) if len(asked) > 1 and key != KEY else None

    with pytest.raises(UnknownNameError, match="unknown map 'town': choose one of b"):
        serve.check_served(vehicle, "town", threading.Event())
    server.answer_under(f"{KEY}/town/**", answer)
    serve.check_served(vehicle, "town", threading.Event())
    assert len(asked) == 2
    serve.check_served(vehicle, "b", threading.Event())
