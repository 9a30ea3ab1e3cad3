"""Localiser: tracks a sensor in the map of a file, and searches the whole map while no pose is known.

A search takes a second for a small map, more for a town. Of a file or a recording, the next scan waits for it. Live it
runs in a thread: scans that come meanwhile wait, and are tracked one after the other when the place is found.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from lidarcodec.evaluation.rigid import Matrix
from lidarcodec.evaluation.trajectory import Scan
from lidarcodec.maps.file import MapReader
from lidarcodec.maps.localise.search import find_pose, standing_at
from lidarcodec.maps.localise.tracker import Estimate, Tracker, turned_by
from lidarcodec.maps.localise.window import MapWindow, MissingTilesError, Window, Windows
from lidarcodec.maps.world import Fit

logger = logging.getLogger(__name__)

MOST_WAITING: Final = 300
"""Scans that wait for a search. When more come, it is given up, because the sensor is elsewhere by then."""
FIRST_REST_S, LONGEST_REST_S = 0.5, 30.0
"""Time from a search that found nothing to the next one, in the time of the scans; doubled each time."""
LONGEST_HINT_REST_S: Final = 4.0
"""The same for hints that did not fit."""
END_S: Final = 5.0


class Localiser:
    """Finds one sensor in a map. A context manager.

    tracker: the last state;  searches: how many were begun;  given_up: how many took too long
    hints: how many proposed poses were tried;  wrong_hints: how many of them did not fit
    """

    def __init__(self, where: Path | Windows, *, background: bool = False) -> None:
        """where: the file of a map, or windows, which are closed at the end
        background: whether searches run in a thread

        Raises SourceError if the map cannot be read.
        """
        self._window, self._searched = _of_file(where) if isinstance(where, Path) else where
        self.tracker = Tracker(self._window)
        self._background = background
        self._search: _Search | None = None
        self._waiting: deque[Scan] = deque()
        self._search_rest, self._hint_rest = _Rest(LONGEST_REST_S), _Rest(LONGEST_HINT_REST_S)
        self._hint: Matrix | None = None
        self._trying = False
        self.searches = self.given_up = self.hints = self.wrong_hints = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop_search()
        for window in (self._window, self._searched):
            window.close()

    @property
    def frame(self) -> str:
        """Frame of the map: `local`, or the zone of UTM."""
        return self._window.frame.name

    @property
    def damaged_tiles(self) -> int:
        """Tiles that could not be decoded."""
        return len(self._window.damaged_tiles | self._searched.damaged_tiles)

    def start(self, x: float, y: float, yaw_deg: float) -> None:
        """Begin near this place, in metres and degrees of the map, to 5 m and 20 degrees.

        Raises SettingsError if the map has no points there.
        """
        pose = standing_at(self._window, x, y) @ turned_by(yaw_deg)
        self.tracker.propose(pose)

    def propose(self, pose: Matrix) -> None:
        """Try this approximate pose (4, 4) with the next scan, if none is known.

        A search goes on until the pose is confirmed. After a pose that did not fit, the next ones rest for a while.
        """
        self._hint = pose

    def take(self, scan: Scan) -> list[Estimate]:
        """Estimates that are known by now, in the order of their scans; the last one is of this scan.

        Raises SourceError for a map that is too dense.
        """
        if self._search is None:
            return [self._tracked(scan)]
        self._waiting.append(scan)
        if not self._search.done:
            beside = self._beside(scan)
            if beside.state == "tracking":
                self._stop_search()
            elif len(self._waiting) > MOST_WAITING:
                self.given_up += 1
                self._stop_search()
            return [beside]
        search, waiting = self._search, list(self._waiting)
        self._search = None
        self._waiting.clear()
        self._use(search, search.scan)
        if self.tracker.unknown:
            waiting = waiting[-1:]
        return [self._tracked(one) for one in waiting]

    def _beside(self, scan: Scan) -> Estimate:
        """The estimate of a scan that comes during a search: a hint is tried, and confirmed by the next scans."""
        if self.tracker.unknown and not self._hinted(scan):
            self._hint = None
            return Estimate(scan.stamp_ns, self.tracker.state, None, None, 0.0, 0.0)
        return self._with_hint(scan)

    def _hinted(self, scan: Scan) -> bool:
        return self._hint is not None and self.tracker.unknown and self._hint_rest.over(scan.stamp_ns)

    def _with_hint(self, scan: Scan) -> Estimate:
        hinted, hint, self._hint = self._hinted(scan), self._hint, None
        if hinted and hint is not None:
            self.hints += 1
            self.tracker.propose(hint)
            self._trying = True
        found = self.tracker.track(scan)
        if self._trying and self.tracker.unknown:
            self._trying = False
            self.wrong_hints += 1
            self._hint_rest.begin(scan.stamp_ns)
        elif found.state == "tracking":
            self._trying = False
            self._hint_rest.end()
        return found

    def _tracked(self, scan: Scan) -> Estimate:
        found = self._with_hint(scan)
        if self.tracker.unknown and self._search is None and self._search_rest.over(scan.stamp_ns):
            self.searches += 1
            self._search = _Search(self._searched, scan, self.tracker.cloud_of(scan))
            if self._background:
                self._search.start()
            else:
                search, self._search = self._search, None
                search.run()
                self._use(search, scan)
        return found

    def _use(self, search: _Search, scan: Scan) -> None:
        """Go on from what a search found, or rest before the next one."""
        fit = search.result()
        if fit is not None:
            self._trying = False
            self.tracker.found(scan, fit)
            self._search_rest.end()
        else:
            self._search_rest.begin(scan.stamp_ns)

    def _stop_search(self) -> None:
        if self._search is not None:
            self._search.stop()
            self._search = None
        self._waiting.clear()


def _of_file(path: Path) -> Windows:
    first = MapWindow(MapReader.open(path))
    try:
        return Windows(first, MapWindow(MapReader.open(path)))
    except BaseException:
        first.close()
        raise


class _Rest:
    """A time between tries that failed, doubled each time, in the time of the scans."""

    def __init__(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self._since_ns, self._rest_s = 0, 0.0

    def begin(self, stamp_ns: int) -> None:
        """Rest from this scan on."""
        self._since_ns = stamp_ns
        self._rest_s = min(2 * self._rest_s, self._longest_s) if self._rest_s else FIRST_REST_S

    def end(self) -> None:
        """Do not rest any more."""
        self._since_ns, self._rest_s = 0, 0.0

    def over(self, stamp_ns: int) -> bool:
        """Whether the next try may begin. Stamps that go back belong to another drive."""
        return not 0 <= stamp_ns - self._since_ns < self._rest_s * 1e9


class _Search:
    """A search for the place of a scan, in this thread or in one of its own."""

    def __init__(self, window: Window, scan: Scan, cloud: Matrix) -> None:
        self.scan = scan
        self._window, self._cloud = window, cloud
        self._fit: Fit | None = None
        self._error: Exception | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.run, name="lidarcodec search", daemon=True)

    def start(self) -> None:
        """Search in a thread."""
        self._thread.start()

    def run(self) -> None:
        """Search here."""
        try:
            self._fit = find_pose(self._window, self._cloud, self._stop.is_set)
        except MissingTilesError as error:
            logger.debug("%s", error)
        except Exception as error:
            self._error = error

    def stop(self) -> None:
        """Give up, and wait for the step that is under way."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(END_S)

    @property
    def done(self) -> bool:
        """Whether the thread has ended."""
        return not self._thread.is_alive()

    def result(self) -> Fit | None:
        """The pose that was found, or None. Raises the error that ended the search."""
        if self._error is not None:
            raise self._error
        return self._fit
