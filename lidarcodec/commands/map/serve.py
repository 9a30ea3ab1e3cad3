"""`lidarcodec map serve` and `map fetch`: maps over the network."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from lidarcodec.commands.endpoints import Given, endpoints_of
from lidarcodec.commands.map.build import check_map_name
from lidarcodec.commands.running.attending import attended
from lidarcodec.commands.running.stopping import StoppedError, stoppable
from lidarcodec.commands.running.telling import tell
from lidarcodec.commands.selection.numbers import numbers_of
from lidarcodec.errors import SettingsError, SourceError, UnknownNameError
from lidarcodec.files.folder_lock import alone_in
from lidarcodec.files.whole import beside, whole
from lidarcodec.maps.served.answers import MapAnswers
from lidarcodec.maps.served.fetching import Around, MapFetch, write_fetched
from lidarcodec.maps.served.manifest import KEY
from lidarcodec.maps.served.shelf import MapShelf
from lidarcodec.maps.served.sources import NetworkTiles, StoppedFetchError, maps_on
from lidarcodec.maps.served.stores import FolderPieces
from lidarcodec.transport import Transport, open_transport
from lidarcodec.transport.asking import ANSWER_S

NO_LIMIT: Final = 1 << 62
LIST_S: Final = 1.0
AGREED_S: Final = 2.0
"""A map is unknown if it is so after this time as well: its server may be starting, or far away."""


def run_serve(paths: list[Path], given: Given, as_json: bool) -> None:
    """Serve maps until a signal arrives. Prints one line when they can be asked for.

    Raises SourceError, SettingsError, TransportError.
    """
    endpoints = endpoints_of(given)
    shelf = MapShelf(paths)
    stop = threading.Event()
    with stoppable(stop.set), open_transport(endpoints, stop=stop) as transport:
        answering = MapAnswers(shelf).declare(transport)
        shelf.start()
        try:
            names = [one.name for one in shelf.all()]
            text = f"Serving {', '.join(names) or 'no map yet'} until you press Ctrl-C"
            print(json.dumps({"maps": names}) if as_json else text, flush=True)
            stop.wait()
        finally:
            answering.close()
            shelf.close()


@dataclass(frozen=True)
class Wanted:
    """The options of `map fetch`."""

    name: str
    out: Path
    around: str | None
    radius_m: float | None
    patience_s: float

    def part(self) -> Around | None:
        """The part of the map; None for everything. Raises SettingsError."""
        if self.around is None:
            if self.radius_m is not None:
                raise SettingsError("--radius needs --around X,Y", "radius")
            return None
        x, y = numbers_of("--around", self.around, "X,Y in metres, as in 120,-40.5", 2)
        return Around(x, y, 200.0 if self.radius_m is None else self.radius_m)


def run_fetch(wanted: Wanted, given: Given, *, force: bool, as_json: bool) -> None:
    """Fetch a map into a file. What was fetched stays in a folder beside the output until that is written.

    Raises SettingsError, SourceError, TransportError, StoppedError after a signal.
    """
    check_map_name(wanted.out, force=force)
    part, endpoints = wanted.part(), endpoints_of(given)
    pieces, stop = beside(wanted.out, ".fetching", folder=True), threading.Event()
    with alone_in(pieces):
        store = FolderPieces(pieces, NO_LIMIT)
        with stoppable(stop.set), open_transport(endpoints, stop=stop) as transport:
            source = NetworkTiles(wanted.name, lambda: transport, store, wanted.patience_s)
            check_served(transport, wanted.name, stop)
            fetch = MapFetch(source, part)
            folder = wanted.out.absolute().parent
            try:
                attended(lambda: fetch.run(folder), source.stop, stop, lambda: _progress(source, fetch))
            except StoppedFetchError:
                raise StoppedError(
                    f"stopped: the fetched tiles stay in {store.folder}; run the same command again to continue"
                ) from None
            if fetch.result is None:
                raise SourceError("the map was not fetched: nothing was written")
            manifest, tiles = fetch.result
            with whole(wanted.out, force=force) as output, output.beside.open("w+b") as file:
                points = write_fetched(file, manifest, tiles, source.read)
                size = file.tell()
        store.clear()
    found = {
        "output": str(output.kept or wanted.out),
        "map": manifest.name,
        "version": manifest.version,
        "tiles": len(tiles),
        "of": len(manifest.tiles),
        "points": points,
        "bytes": size,
        "bytes_received": source.received,
    }
    text = (
        f"{found['output']}: {found['tiles']} of {found['of']} tiles of '{manifest.name}', {points:,} points in "
        f"{size:,} bytes, {source.received:,} bytes received"
    )
    tell(found, text, as_json)


def check_served(transport: Transport, name: str, stop: threading.Event) -> None:
    """Raise UnknownNameError if nobody answers about this map, twice, and others say which maps they serve.

    Without any answer there may be no link yet, which is waited for elsewhere.
    """
    for _ in range(2):
        if transport.ask(f"{KEY}/{name}", b"", ANSWER_S) is not None:
            return
        served = [one["name"] for one in maps_on(transport, LIST_S)]
        if not served or name in served or stop.wait(AGREED_S):
            return
    raise UnknownNameError("map", name, served)


def _progress(source: NetworkTiles, fetch: MapFetch) -> str:
    return f"waits {source.waiting}" if source.waiting else f"{fetch.done} of {fetch.tiles} tiles"
