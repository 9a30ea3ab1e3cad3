"""Vehicle: several sensors of one vehicle, in one process and one network session.

Each sensor has its own thread that opens its source and publishes it. If a live source fails, the thread logs why and
tries again: after one second, then two, up to half a minute. A sensor that fails never stops another one. Endpoints
that cannot be used end all sensors, because waiting does not help.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from lidarcodec.apps.ending import ended
from lidarcodec.apps.health import SensorState
from lidarcodec.apps.past.answers import answers_of
from lidarcodec.apps.past.keeper import Keep, Keeper, check_apart
from lidarcodec.apps.publisher.originals import check_local
from lidarcodec.apps.publisher.publisher import START_S, Publisher, Rate
from lidarcodec.apps.recorder import Record
from lidarcodec.errors import LidarCodecError, SourceError, TransportError
from lidarcodec.mounting import Mounting
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.base import PacketSource
from lidarcodec.transport import Endpoints, Transport, open_transport
from lidarcodec.transport.keys import StreamKeys

logger = logging.getLogger(__name__)

FIRST_WAIT_S, LONGEST_WAIT_S = 1.0, 30.0
WELL_S = 60.0
"""After a source ran this long without error, the wait before a retry is reset to the shortest."""
TICK_S = 0.2


@dataclass(frozen=True)
class SensorPlan:
    """One sensor: its name, a function that opens its source, and options of its publisher.

    live: whether to try again if the source fails; useless for files
    """

    name: str
    open: Callable[[], PacketSource]
    settings: StreamSettings
    live: bool = True
    rate: Rate | None = None
    with_poses: bool = False
    mount: Mounting | None = None
    record: Record | None = None
    keep: Keep | None = None
    original: bool = False


class Vehicle:
    """Publishes several sensors. A context manager: starts on entering, stops on leaving."""

    def __init__(self, name: str, sensors: Sequence[SensorPlan], endpoints: Endpoints | None = None) -> None:
        """Raises SettingsError for invalid names or limits, and for originals that would leave the machine."""
        if any(plan.original for plan in sensors):
            check_local(endpoints or Endpoints())
        self.name, self._endpoints = name, endpoints
        self._transport: Transport | None = None
        self._opening, self._tried = threading.Lock(), threading.Event()
        self._stop = threading.Event()
        self._interrupted = False
        self._failure: TransportError | None = None
        self._sensors = [
            _Sensor(StreamKeys(name, plan.name), plan, self._open, self._stop, self._endpoints) for plan in sensors
        ]

    def start(self) -> None:
        """Begin with all sensors."""
        for sensor in self._sensors:
            sensor.start()

    def opened(self) -> None:
        """Wait until the network is open or cannot be opened, for a second at most: a sensor may be silent, or a router
        out of reach.

        Raises TransportError if the endpoints cannot be used.
        """
        self._tried.wait(START_S)
        if self._failure is not None:
            raise self._failure

    def wait(self) -> None:
        """Wait until every source has ended, or `interrupt` is called.

        Raises TransportError if the endpoints cannot be used.
        """
        while any(sensor.thread.is_alive() for sensor in self._sensors) and not self._interrupted:
            self._stop.wait(TICK_S)
            if self._failure is not None:
                raise self._failure

    def interrupt(self) -> None:
        """Make `wait` return soon. Signal handlers may call this method only: it takes no lock."""
        self._interrupted = True

    def stop(self) -> None:
        """End everything. A second call does nothing."""
        self._stop.set()
        ended(thread for sensor in self._sensors for thread in (sensor.thread, sensor.answering))
        for sensor in self._sensors:
            sensor.close()
        if self._transport is not None:
            self._transport.close()

    def __enter__(self) -> Vehicle:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()

    def statuses(self) -> list[dict[str, Any]]:
        """The last status of every sensor that has published."""
        return [sensor.status for sensor in self._sensors if sensor.status is not None]

    def failures(self) -> dict[str, LidarCodecError | OSError]:
        """Errors of the sensors that do not publish now, by name."""
        return {sensor.plan.name: sensor.failure for sensor in self._sensors if sensor.failure is not None}

    def states(self) -> list[SensorState]:
        """The current state of every sensor whose source has not ended."""
        return [one.state() for one in self._sensors if one.failure is not None or one.thread.is_alive()]

    def _open(self, stop: threading.Event) -> Transport:
        """The shared session; the first sensor opens it."""
        with self._opening:
            if self._transport is None:
                try:
                    self._transport = open_transport(self._endpoints, stop=self._stop)
                except TransportError as error:
                    if not self._stop.is_set():
                        self._failure = error
                    raise
                finally:
                    self._tried.set()
            return self._transport


class _Sensor:
    """One sensor and its thread."""

    def __init__(
        self,
        keys: StreamKeys,
        plan: SensorPlan,
        network: Callable[[threading.Event], Transport],
        stop: threading.Event,
        endpoints: Endpoints | None,
    ) -> None:
        self._endpoints = endpoints or Endpoints()
        self.keys, self.plan = keys, plan
        self.status: dict[str, Any] | None = None
        self.failure: LidarCodecError | OSError | None = None
        self._network, self._stop = network, stop
        self._publisher: Publisher | None = None
        self.thread = threading.Thread(target=self._run, name=f"lidarcodec {plan.name}", daemon=True)
        check_apart(plan.record, plan.keep)
        self._keeper = None if plan.keep is None else Keeper(plan.keep, keys)
        self.answering = threading.Thread(target=self._answer, name=f"lidarcodec past of {plan.name}", daemon=True)

    def start(self) -> None:
        """Begin to publish, and to answer about what is kept."""
        if self._keeper is not None:
            self._keeper.start()
            self.answering.start()
        self.thread.start()

    def close(self) -> None:
        """Write what is to be kept, after both threads have ended."""
        if self._keeper is not None:
            self._keeper.close()

    def state(self) -> SensorState:
        """The current state."""
        publisher, failure = self._publisher, self.failure
        if failure is not None or publisher is None:
            why = None if failure is None else str(failure)
            return SensorState(f"{self.keys.vehicle}/{self.keys.sensor}", failure=why)
        return SensorState.of(publisher.status())

    def _answer(self) -> None:
        """Answer about what is kept, also while the source has failed."""
        keeper = self._keeper
        if keeper is None:
            return
        try:
            declared = answers_of(keeper, lambda: self._publisher).declare(self._network(self._stop))
        except TransportError as error:
            if not self._stop.is_set():
                logger.warning("%s: kept data cannot be fetched from here: %s", self.keys.prefix, error)
            return
        while not self._stop.wait(TICK_S):
            pass
        for one in declared:
            one.close()

    def _run(self) -> None:
        wait_s = FIRST_WAIT_S
        while not self._stop.is_set():
            begun = time.monotonic()
            try:
                self._publish()
            except TransportError as error:
                self.failure = error
                return
            except (LidarCodecError, OSError) as error:
                self.failure = error
            except BaseException as error:  # no more threads, or a panic of native code: nobody else tells of it
                logger.exception("unexpected error while publishing %s", self.keys.prefix)
                self.failure = SourceError(f"unexpected {type(error).__name__}: {error}")
            else:
                return
            if not self.plan.live:
                logger.warning("%s stops publishing: %s", self.keys.prefix, self.failure)
                return
            wait_s = FIRST_WAIT_S if time.monotonic() - begun > WELL_S else wait_s
            logger.warning("%s: %s; trying again in %g s", self.keys.prefix, self.failure, wait_s)
            self._stop.wait(wait_s)
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    def _publish(self) -> None:
        plan = self.plan
        with plan.open() as source:
            publisher = Publisher(
                source,
                plan.settings,
                vehicle=self.keys.vehicle,
                sensor=self.keys.sensor,
                rate=plan.rate,
                endpoints=self._endpoints,
                transport=self._network,
                record=plan.record,
                keep=self._keeper,
                poses=source.poses if plan.with_poses else None,
                mount=plan.mount,
                original=plan.original,
            )
            try:
                with publisher:
                    self.failure, self._publisher = None, publisher
                    while not publisher.wait(TICK_S) and not self._stop.is_set():
                        pass
            finally:
                publisher.stop()  # also if not all of its threads could be started
            self.status, self._publisher = _with_earlier(publisher.status(), self.status), None
            if publisher.failure is not None and not self._stop.is_set():
                raise publisher.failure


def _with_earlier(status: dict[str, Any], before: dict[str, Any] | None) -> dict[str, Any]:
    """The status of a reopened sensor, with the recording errors of before."""
    earlier, now = (before or {}).get("recording"), status["recording"]
    if earlier is None or now is None:
        return status
    counts = Counter(earlier["counts"])
    counts.update(now["counts"])
    recording = now | {"counts": dict(counts), "stopped": now["stopped"] or earlier["stopped"]}
    return status | {"recording": recording}
