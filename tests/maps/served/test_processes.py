"""Maps over real Zenoh, served by a process of its own: whole maps, twenty vehicles at once, and a server that dies."""

from __future__ import annotations

import json
import math
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from lidarcodec.errors import TransportError
from lidarcodec.maps import open_map, read_map
from lidarcodec.maps.served.answers import HEAD
from lidarcodec.maps.served.fetching import MapFetch, write_fetched
from lidarcodec.maps.served.sources import NetworkTiles
from lidarcodec.maps.served.stores import FolderPieces
from lidarcodec.transport import Endpoints, open_transport, part_size
from tests.apps.relay import Relay
from tests.command_line import run_here, start, the_one_line
from tests.maps.served.conftest import write
from tests.maps.towns import same_points
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

VEHICLES = 20
PART_BYTES = 128
"""Of parts on the link that is lost, so that tiles have several."""


class Serving:
    """`map serve` in a process of its own, which answers by the time that this is made."""

    def __init__(self, *maps, port=None):
        self.port = port or free_port()
        self.process = start("map", "serve", *maps, "--listen", f"tcp/127.0.0.1:{self.port}", "--json")
        self.names = json.loads(self.process.stdout.readline())["maps"]

    def endpoint(self):
        return f"tcp/127.0.0.1:{self.port}"

    def end(self, number):
        self.process.send_signal(number)
        _, errors = self.process.communicate(timeout=60)
        return self.process.returncode, errors


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    return write(tmp_path_factory.mktemp("maps") / "town.lcmap")


@pytest.fixture(scope="module")
def serving(town):
    made = Serving(town)
    yield made
    assert made.end(signal.SIGTERM) == (0, "")


def fetch(serving, name, out, *words):
    return run_here("map", "fetch", name, "-o", out, "--connect", serving.endpoint(), *words)


def test_a_map_comes_whole_or_in_part_and_what_is_not_there_is_one_line(serving, town, tmp_path, capfd):
    assert serving.names == ["town"]
    whole, part = tmp_path / "whole.lcmap", tmp_path / "part.lcmap"
    told = fetch(serving, "town", whole, "--json")
    assert told.returncode == 0, told.stderr
    assert whole.read_bytes() == town.read_bytes()
    assert json.loads(capfd.readouterr().out)["tiles"] == 10
    assert not whole.with_suffix(".fetching").exists()
    assert fetch(serving, "town", part, "--around", "10,0", "--radius", "30").returncode == 0
    assert {x for x, _ in (read_map(part).steps[:, :2] // 2500).tolist()} == {0}
    refused = fetch(serving, "village", tmp_path / "a.lcmap")
    assert refused.returncode == 2
    assert the_one_line(refused).endswith("unknown map 'village': choose one of town")
    far = fetch(serving, "town", tmp_path / "a.lcmap", "--around", "9000,0")
    assert "lies between x 0 and y -50, x 250 and y 50" in the_one_line(far)
    for words in (("--around", "x"), ("--around", "1,nan"), ("--radius", "3")):
        assert fetch(serving, "town", tmp_path / "a.lcmap", *words).returncode == 2


def test_a_network_that_cannot_be_reached_is_waited_for_and_told(tmp_path):
    nobody = Endpoints.of(f"tcp/127.0.0.1:{free_port()}")
    with pytest.raises(TransportError, match="could be reached"):
        open_map("town", endpoints=nobody, patience_s=0.2)


@pytest.mark.sweep
def test_twenty_vehicles_at_once_get_all_tiles(serving, town):
    whole = read_map(town)

    def drive(_):
        with open_map("town", radius_m=math.inf, endpoints=Endpoints.of(serving.endpoint()), in_flight=2) as found:
            found.move(0.0, 0.0)
            return found.wait(60.0) and same_points(whole, found.points())

    with ThreadPoolExecutor(VEHICLES) as pool:
        assert all(pool.map(drive, range(VEHICLES)))


def test_a_fetch_goes_on_mid_tile_when_the_server_was_killed_and_is_back(town, tmp_path, monkeypatch):
    monkeypatch.setattr(part_size, "MIN_PART", PART_BYTES)
    monkeypatch.setattr(part_size, "MAX_PART", PART_BYTES)
    first = Serving(town)
    relay = Relay(first.port, kbit=100)
    store = FolderPieces(tmp_path / "cache", 1 << 30)
    with open_transport(Endpoints.of(f"tcp/127.0.0.1:{relay.port}")) as session:
        source = NetworkTiles("town", lambda: session, store, 60.0)
        going = MapFetch(source)
        thread = threading.Thread(target=going.run, args=[tmp_path], daemon=True)
        thread.start()

        def stopped_in_a_tile():
            """What was under way has come by then."""
            first.process.send_signal(signal.SIGSTOP)
            time.sleep(0.3)
            if list((tmp_path / "cache").glob("*.part")) and going.done > 0:
                return True
            first.process.send_signal(signal.SIGCONT)
            return False

        assert eventually(stopped_in_a_tile)
        first.end(signal.SIGKILL)
        cut = {path.stem: path.stat().st_size for path in (tmp_path / "cache").glob("*.part")}
        assert cut
        assert going.result is None
        relay.kbit = 100_000
        second = Serving(town, port=first.port)
        thread.join(60.0)
        manifest, tiles = going.result
        out = tmp_path / "out.lcmap"
        with out.open("w+b") as file:
            write_fetched(file, manifest, tiles, source.read)
        source.stop()
    relay.close()
    second.end(signal.SIGTERM)
    assert out.read_bytes() == town.read_bytes()
    assert source.received <= manifest.size + HEAD.size * (1 + manifest.size // PART_BYTES + 2 * len(tiles))
