"""A town as a map: what building it takes, how large 5 % of it are, and twenty vehicles that fetch it at once.

    python -m benchmarks.town --cache DIR [--km 10] [--every 4] [--save]

`map build` and `map compress` are processes of their own. `map serve` is another one, that twenty vehicles in this
process ask for the whole small map, each over its own session. The link of one of them is slow, and is lost in the
middle of a tile for a few seconds. The map and what building it took are kept in DIR.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks import results
from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.maps.file import read_map
from lidarcodec.maps.served.fetching import MapFetch, write_fetched
from lidarcodec.maps.served.sources import NetworkTiles
from lidarcodec.maps.served.stores import FolderPieces
from lidarcodec.sources import open_source
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.endpoints import free_port
from tests.apps.relay import Relay

SCENE: Final = "sim:city"
FRAME_S: Final = 0.1
VEHICLES: Final = 20
KEPT: Final = "5%"
LONGEST_S: Final = 7200.0
SLOW_KBIT, LOST_S = 400.0, 5.0
"""Rate of the link that is lost, and for how long."""
PATIENCE_S: Final = 300.0
AGAIN_M, AFTER_PLACES = 10.0, 100
"""The drive is on a street again if it was so near to this place before, and that is so many places ago."""


def frames_of(length_m: float) -> int:
    """How many frames the drive takes for a length."""
    with open_source(SCENE) as source:
        assert source.poses is not None
        stamps = source.start_ns + np.arange(round(LONGEST_S)) * 1_000_000_000  # type: ignore[operator]
        known = [pose for stamp in stamps if (pose := source.poses.at(int(stamp))) is not None]
    places = np.stack(known)[:, :3, 3]
    driven = np.linalg.norm(np.diff(places, axis=0), axis=1).cumsum()
    return round(int(np.searchsorted(driven, length_m) + 1) / FRAME_S)


def streets_m(path: Matrix) -> float:
    """Length of a path without what it drove before. path: (P, 3), about a place a metre

    >>> there = np.stack([np.arange(300.0), np.zeros(300), np.zeros(300)], axis=1)
    >>> round(streets_m(np.concatenate([there, there[::-1]])), -1)
    340.0
    """
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    found = 0.0
    for number, step in enumerate(steps.tolist(), 1):
        before = path[: max(number - AFTER_PLACES, 0), :2] - path[number, :2]
        if not (np.einsum("ij,ij->i", before, before) < AGAIN_M**2).any():
            found += step
    return found


def command_cost(*words: str) -> dict[str, Any]:
    """What a command says with --json, with its processor seconds and peak memory in MiB."""
    command = [sys.executable, "-m", "lidarcodec", *words, "--json"]
    with tempfile.TemporaryFile() as out:
        process = subprocess.Popen(command, stdout=out)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)} ended with {process.returncode}")
        out.seek(0)
        said = json.loads(out.read())
    return {
        "said": said,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_mib": used.ru_maxrss / 1024,
    }


def built(cache: Path, km: float, every: int) -> tuple[Path, dict[str, Any]]:
    """The map of the town, and what building it took; both are kept."""
    cache.mkdir(parents=True, exist_ok=True)
    town = cache / f"town-{km:g}-{every}.lcmap"
    known = town.with_suffix(".json")
    if not known.exists():
        source = f"{SCENE}?frames={frames_of(1000 * km)}"
        cost = command_cost("map", "build", source, "-o", str(town), "--every", str(every), "--force")
        known.write_text(json.dumps(cost | {"source": source}))
    return town, json.loads(known.read_text())


@contextlib.contextmanager
def serving(path: Path) -> Iterator[int]:
    """`map serve` of a map in a process of its own, and its port."""
    port = free_port()
    command = [sys.executable, "-m", "lidarcodec", "map", "serve", str(path), "--listen", f"tcp/127.0.0.1:{port}"]
    process = subprocess.Popen([*command, "--json"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        json.loads(process.stdout.readline())
        yield port
    finally:
        process.terminate()
        process.wait(60)


class Vehicle:
    """A vehicle that fetches a whole map over its own session. seconds: how long it took; received: bytes"""

    def __init__(self, port: int, path: Path, folder: Path) -> None:
        self._port, self._original = port, path
        self.folder = folder
        self.seconds, self.received, self.same = 0.0, 0, False

    def drive(self) -> None:
        """Fetch the map, and compare it with the original."""
        begun = time.monotonic()
        self.folder.mkdir()
        store = FolderPieces(self.folder / "cache", 1 << 30)
        with open_transport(Endpoints.of(f"tcp/127.0.0.1:{self._port}")) as session:
            source = NetworkTiles(self._original.stem, lambda: session, store, PATIENCE_S)
            fetch = MapFetch(source)
            fetch.run(self.folder)
            self.seconds, self.received = time.monotonic() - begun, source.received
            assert fetch.result is not None
            with (self.folder / "out.lcmap").open("w+b") as file:
                write_fetched(file, *fetch.result, source.read)
            source.stop()
        self.same = (self.folder / "out.lcmap").read_bytes() == self._original.read_bytes()

    def begun_tiles(self) -> int:
        """Tiles of which a part is here."""
        return len([part for part in (self.folder / "cache").glob("*.part") if part.stat().st_size])


def lose_link(relay: Relay, vehicle: Vehicle) -> int:
    """Cut a vehicle's link when a tile is under way, and give it back later: how many tiles were cut."""
    until = time.monotonic() + PATIENCE_S
    while not (cut := vehicle.begun_tiles()) and time.monotonic() < until:
        time.sleep(0.005)
    relay.kbit = 0.0
    relay.cut()
    cut = vehicle.begun_tiles() or cut
    time.sleep(LOST_S)
    relay.kbit = SLOW_KBIT * 100
    return cut


def fetched(path: Path) -> dict[str, Any]:
    """Twenty vehicles fetch a map at once, and one of them loses its link."""
    with serving(path) as port, tempfile.TemporaryDirectory() as folder:
        relay = Relay(port, kbit=SLOW_KBIT)
        try:
            ports = [relay.port, *[port] * (VEHICLES - 1)]
            vehicles = [Vehicle(one, path, Path(folder) / str(at)) for at, one in enumerate(ports)]
            with ThreadPoolExecutor(VEHICLES + 1) as pool:
                losing = pool.submit(lose_link, relay, vehicles[0])
                for drive in [pool.submit(vehicle.drive) for vehicle in vehicles]:
                    drive.result()
                cut = losing.result()
        finally:
            relay.close()
    others = [vehicle.seconds for vehicle in vehicles[1:]]
    return {
        "same": sum(vehicle.same for vehicle in vehicles),
        "slowest_s": max(others),
        "lost_s": vehicles[0].seconds,
        "cut": cut,
        "received": vehicles[0].received,
    }


def table(cache: Path, km: float, every: int) -> list[list[str]]:
    """The rows: a name, what was measured, and what was asked."""
    town, cost = built(cache, km, every)
    small = cache / f"small-{km:g}-{every}.lcmap"
    less = command_cost("map", "compress", str(town), "-o", str(small), "--keep", KEPT, "--force")
    whole = read_map(town)
    streets_km, driven_km = streets_m(whole.path.astype(np.float64)) / 1000, whole.length_m / 1000
    size = small.stat().st_size
    found = fetched(small)
    return [
        ["kilometres driven, and of different streets", f"{driven_km:.2f}, {streets_km:.2f}", "10"],
        ["scans of the map", f"{cost['said']['scans']:,}", ""],
        ["minutes of a processor to build it", f"{cost['cpu_s'] / 60:.0f}", ""],
        ["MiB at most while it is built", f"{cost['peak_mib']:,.0f}", "2,000"],
        ["points, MB, of the whole map", f"{len(whole):,}, {town.stat().st_size / 1e6:.1f}", ""],
        [f"MiB at most in `map compress --keep {KEPT}`", f"{less['peak_mib']:,.0f}", ""],
        [f"points, kB, of {KEPT}", f"{round(0.05 * len(whole)):,}, {size / 1000:,.0f}", ""],
        ["MB a kilometre driven, and of different streets", f"{size / 1e6 / driven_km:.3f}, "
         f"{size / 1e6 / streets_km:.3f}", "0.25"],
        ["vehicles that fetched all of it at once, byte for byte", f"{found['same']} of {VEHICLES}", f"{VEHICLES}"],
        ["seconds, of the slowest with a link that holds", f"{found['slowest_s']:.1f}", ""],
        ["tiles that were under way when the link of one of them was lost", f"{found['cut']}", "1"],
        ["bytes that vehicle received, in shares of the map", f"{found['received'] / size:.4f}", ""],
    ]  # fmt: skip


def main() -> None:
    """Print, and with --save write the table."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--cache", type=Path, default=Path("build/town"))
    words.add_argument("--km", type=float, default=10.0)
    words.add_argument("--every", type=int, default=4)
    words.add_argument("--save", action="store_true")
    asked = words.parse_args()
    about = f"One drive of `{SCENE}`; every {asked.every}th turn is in the map."
    title = {"title": "A town as a map, and twenty vehicles at once", "about": about}
    found = results.Result(results.here() | title, ["", "measured", "asked"], table(asked.cache, asked.km, asked.every))
    print(found.markdown())
    if asked.save:
        results.write("maps/town", found)


if __name__ == "__main__":
    main()
