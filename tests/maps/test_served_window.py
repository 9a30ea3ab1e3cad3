"""A sensor is found in a map that is served: tiles come, stay away and come again, and no search guesses meanwhile."""

import threading

import numpy as np
import pytest

from lidarcodec.maps.compress import compressed
from lidarcodec.maps.file import write_map
from lidarcodec.maps.localise import served as served_module
from lidarcodec.maps.localise.localiser import Localiser
from lidarcodec.maps.localise.search import find_pose
from lidarcodec.maps.localise.served import served_tiles, served_windows
from lidarcodec.maps.localise.window import MissingTilesError
from lidarcodec.maps.served.answers import HEAD, MapAnswers
from lidarcodec.maps.served.manifest import KEY
from lidarcodec.maps.served.shelf import MapShelf
from lidarcodec.transport import asking
from lidarcodec.transport.memory import MemoryNetwork
from tests.maps.test_localise import TOWN, off_m, scan_at, way
from tests.transport.test_contract import eventually


class Town:
    """A server of a town. parts: how many answers about tiles come yet, of at most `size` bytes"""

    def __init__(self, transport, path):
        self._answers, self.parts, self.size = MapAnswers(MapShelf([path])), 1 << 20, 1 << 20
        transport.answer_under(f"{KEY}/**", self._answer)

    def _answer(self, key, data):
        if key.count("/") < 5:
            return self._answers.answer(key, data)
        self.parts -= 1
        return self._answers.answer(key, data)[: HEAD.size + self.size] if self.parts >= 0 else None


@pytest.fixture
def ends(tmp_path, monkeypatch):
    monkeypatch.setattr(asking, "ANSWER_S", 0.2)
    monkeypatch.setattr(asking, "FIRST_WAIT_S", 0.02)
    monkeypatch.setattr(asking, "LONGEST_WAIT_S", 0.05)
    monkeypatch.setattr(served_module, "ANEW_S", 0.0)
    path = tmp_path / "town.lcmap"
    with path.open("w+b") as file:
        write_map(file, compressed(TOWN, "voxel", len(TOWN) // 4)[0])
    network = MemoryNetwork()
    with network.transport() as server, network.transport() as vehicle:
        yield Town(server, path), vehicle


@pytest.mark.sweep
def test_a_sensor_is_found_by_a_search_in_tiles_that_come_once(ends):
    source = served_tiles("town", ends[1], 5.0)
    windows = served_windows(source)
    with Localiser(windows) as localiser:
        states = [localiser.take(scan_at(way(number), number))[-1] for number in range(5)]
        assert states[-1].state == "tracking"
        assert off_m(states[-1].pose, way(4)) < 0.08
        assert source.tiles == len(windows.tracked.places)
        assert localiser.frame == "local"
        assert localiser.damaged_tiles == 0


def test_without_its_tiles_a_search_says_nothing_and_a_tile_goes_on_where_the_link_was_lost(ends, monkeypatch):
    monkeypatch.setattr(served_module, "WAIT_S", 0.2)
    town, vehicle = ends
    town.parts, town.size = 6, 400
    source = served_tiles("town", vehicle, 5.0)
    windows = served_windows(source)
    with Localiser(windows) as localiser:
        with pytest.raises(MissingTilesError, match="have not arrived yet"):
            find_pose(windows.searched, scan_at(way(0), 0).points.astype(np.float64))
        assert localiser.take(scan_at(way(0), 0))[-1].state == "searching"
        assert source.tiles < len(windows.tracked.places)
        assert 0 < source.received <= 6 * (400 + HEAD.size)
        town.parts, town.size = 1 << 20, 1 << 20
        assert eventually(lambda: source.tiles == len(windows.tracked.places))
        localiser.start(21.0, 20.0, 4.0)  # its tiles are here
        states = [localiser.take(scan_at(way(number), number + 100))[-1].state for number in range(4)]
        assert states[-1] == "tracking"
        tiles = source.manifest().tiles
        assert source.received <= sum(tile.size for tile in tiles) + HEAD.size * (6 + len(tiles))


def test_a_start_waits_for_its_tiles(ends):
    town, vehicle = ends
    town.parts = 0
    source = served_tiles("town", vehicle, 5.0)
    coming = threading.Timer(0.3, lambda: setattr(town, "parts", 1 << 20))
    coming.start()
    with Localiser(served_windows(source, (21.0, 20.0))) as localiser:
        coming.join()
        localiser.start(21.0, 20.0, 4.0)
    stop = threading.Event()
    stop.set()
    town.parts = 0
    windows = served_windows(served_tiles("town", vehicle, 5.0), (21.0, 20.0), stop)
    assert windows.tracked.frame.name == "local"
    windows.tracked.close()
    windows.searched.close()
