"""Publisher: sends the packets of a source, live, to all subscribers.

    source thread    packets -> assembler -> mailbox of one frame (newest wins)
    encode thread    waits until the last message has arrived -> newest frame -> encoder -> bytes -> network
    status thread    once a second: status as JSON

The source never waits for the encoder, and the encoder never waits for the network. Frames that come too fast are
replaced in the mailbox before they are encoded, and counted.
"""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path
from typing import Any, Self, Unpack

from lidarcodec.apps.clocks import SYSTEM, Clock
from lidarcodec.apps.control import Applied
from lidarcodec.apps.ending import ended
from lidarcodec.apps.once import Once
from lidarcodec.apps.past.answers import answers_of
from lidarcodec.apps.past.keeper import Keep, Keeper, check_apart
from lidarcodec.apps.publisher.changes import Changes
from lidarcodec.apps.publisher.coding import Coding
from lidarcodec.apps.publisher.desk import Desk
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.publisher.network import Network, OpenTransport
from lidarcodec.apps.publisher.originals import Originals, check_local
from lidarcodec.apps.publisher.path_times import LIMIT_S
from lidarcodec.apps.publisher.refining import Refining
from lidarcodec.apps.publisher.sending import Counters, Sending, SideOutputs
from lidarcodec.apps.publisher.source import NOMINAL_HZ, FrameFeed, Rate
from lidarcodec.apps.publisher.status import StatusBoard
from lidarcodec.apps.recorder import BackgroundRecorder, Record
from lidarcodec.apps.worker.isolation import Isolate
from lidarcodec.codecs.other_sensors import check_for
from lidarcodec.errors import SettingsError, TransportError, WorkerError, told
from lidarcodec.mounting import Mounting
from lidarcodec.pipeline import check
from lidarcodec.settings import SettingChanges, StreamSettings
from lidarcodec.sources.base import Source
from lidarcodec.sources.poses import Poses
from lidarcodec.transport import Endpoints, Transport
from lidarcodec.transport.base import Closeable, Priority, Sender
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.units import FRAME_PACKETS

logger = logging.getLogger(__name__)

PATIENT_S = 30.0
"""Longest wait for a report with rate `max`, which loses no frame."""
TICK_S = 0.2
"""Interval at which waiting threads check whether to stop."""
LAST_FRAME_S = 1.0
"""Time for the last frame at the end, before the encoder's process is killed."""
STATUS_S = 1.0
START_S = 1.0
"""How long `start` waits for the network: long enough to find unusable endpoints."""
LAST_READ_S = 5.0
"""Time to read and record the waiting packets at the end; these are at most the packets of 4.7 s."""
JOIN_S = 10.0


class Publisher:
    """Publishes one sensor. A context manager: starts on entering, stops on leaving.

    source:    from `lidarcodec.open_source`; `stop` closes it
    rate:      frames of 348 packets a second for a source that is not live (default 10), or `max`: every frame is sent,
               as fast as the receivers take them, with its own time stamps
    loop:      begin again at the end of a source that is not live
    endpoints: where to listen and connect; by default nothing leaves the machine
    transport: an open transport, or a function that opens one (argument: the event that stops it). The caller closes
               it; endpoints then only describe it
    poses:     poses of the sensor, sent with each frame
    mount:     where the sensor sits on its vehicle; by default what the source says
    original:  also send uncompressed frames while a local viewer compares
    record:    records all packets or frames, whether sent or not: a `Record`, or a folder for raw packets
    keep:      keeps the last hours exactly, and answers receivers that fetch parts of them; or a started keeper, which
               the caller closes and answers about
    isolate:   which encoders run in their own process: `always`, `never`, or `auto` (those with native code that may
               crash). By default the variable LIDARCODEC_ISOLATE, otherwise `auto`
    clock:     the clocks of this machine
    """

    def __init__(
        self,
        source: Source,
        settings: StreamSettings | None = None,
        *,
        vehicle: str = "vehicle",
        sensor: str = "lidar",
        rate: Rate | None = None,
        loop: bool = False,
        endpoints: Endpoints | None = None,
        transport: Transport | OpenTransport | None = None,
        record: Record | str | Path | None = None,
        keep: Keep | Keeper | None = None,
        poses: Poses | None = None,
        mount: Mounting | None = None,
        original: bool = False,
        isolate: Isolate | None = None,
        clock: Clock = SYSTEM,
    ) -> None:
        """Raises SettingsError or UnknownNameError if settings, names or limits are not allowed, and TransportError for
        an invalid configuration file.
        """
        self.keys = StreamKeys(vehicle, sensor)
        self._once = Once(logger)
        if isinstance(source, str | Path):
            raise SettingsError(f"a Publisher takes an open source: write open_source('{source}')", "source")
        asked = check_for(source.sensor, check(settings or StreamSettings()))
        live_rate = rate if isinstance(rate, int | float) and not source.live else NOMINAL_HZ
        self._coding = Coding(asked, 1.0 / (live_rate * FRAME_PACKETS), isolate, self._worker_failed, self._once)
        self._network = Network(endpoints, transport)
        self._every = rate == "max" and not source.live
        kept = Record.of(record)
        check_apart(kept, keep.keep if isinstance(keep, Keeper) else keep)
        mount = mount or getattr(source, "mount", None)
        self._recorder = (
            None if kept is None else BackgroundRecorder(kept.folder, self.keys, None, mount, **kept.limits)
        )
        self._stop, self._done, self._opened = threading.Event(), threading.Event(), threading.Event()
        self._interrupted = self._begun = False
        self._declared: list[Closeable] = []
        self._failure: BaseException | None = None
        recorded = None if kept is None or self._recorder is None else (self._recorder, kept.form)
        self._own_keeper = None if keep is None or isinstance(keep, Keeper) else Keeper(keep, self.keys)
        self._keeper = keep if isinstance(keep, Keeper) else self._own_keeper
        speed = 10.0 if rate is None else rate
        self._feed = FrameFeed(
            source, asked.framing, speed, recorded, poses, clock, self._keeper, loop=loop, mount=mount
        )
        limit_s = PATIENT_S if self._every else LIMIT_S
        self._flight = Flight(asked.follow, limit_s=limit_s, slow_server=not self._network.one_machine)
        self._originals: Originals | None = None
        if original:
            check_local(self._network.endpoints)
            self._originals = Originals(self.keys, self.stream_id, self._once)
        self._board = StatusBoard(self.keys, self.stream_id, clock)
        counters = Counters(self._board, self._once)
        self._refining = Refining(self.keys, lambda: self._network.transport, self._flight, self._once)
        side_outputs = SideOutputs(self._originals, self._recorder, self._refining)
        self._sending = Sending(
            self._coding, self._feed, self._flight, counters, self._stop, every=self._every, side_outputs=side_outputs
        )
        self._desk = Desk(self, self.keys, self._flight, self._board, clock, self._once)
        self._tell_now = threading.Event()
        self._changes = Changes(asked, self._coding, self._sending, self._runs, self._tell_now.set)
        self._threads = [
            threading.Thread(target=self._feed_frames, name="lidarcodec source", daemon=True),
            threading.Thread(target=self._encode_frames, name="lidarcodec encoder", daemon=True),
            threading.Thread(target=self._tell_status, name="lidarcodec status", daemon=True),
        ]

    @property
    def settings(self) -> StreamSettings:
        """The current settings as requested. If the codec is `auto`, the status has the one in use."""
        return self._changes.asked

    @property
    def failure(self) -> BaseException | None:
        """The error that ended the source or the network; None without error, also at the end of the source."""
        return self._failure

    @property
    def busy(self) -> bool:
        """Whether a message is under way."""
        return self._flight.busy

    def room(self, most: int, least: int) -> tuple[float, int] | None:
        """How long something else than a live message has to wait for the link, and if that is 0, how many bytes of
        `most` fit before the next live message, on a short path at least `least`. None: that is not known."""
        return self._flight.room(most, least)

    @property
    def next_index(self) -> int:
        """Index of the next frame to be encoded."""
        return self._sending.next_index

    @property
    def stream_id(self) -> int:
        """Random number, new at each start."""
        return self._coding.encoder.stream_id

    def start(self) -> Self:
        """Open the network and begin. If the router is unreachable, it tries again while the source runs.

        Raises TransportError if the endpoints cannot be used.
        """
        if self._begun:
            raise TransportError("a publisher can be started only once: create a new one")
        self._begun = True
        if self._recorder is not None:
            self._recorder.start()
        if self._keeper is not None:
            self._keeper.status = self.status
        if self._own_keeper is not None:
            self._own_keeper.start()
        self._coding.start()
        for thread in self._threads:
            thread.start()
        self._opened.wait(START_S)
        if isinstance(self._failure, TransportError):
            self.stop()
            raise self._failure
        return self

    def run(self) -> None:
        """Start, and return when the source ends, or `interrupt` or `stop` is called.

        Raises SourceError or PacketError of the source; TransportError if the endpoints cannot be used.
        """
        with self:
            self.wait()
        if self._failure is not None:
            raise self._failure

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until the source has ended and everything was sent, or until interrupted. Returns whether it has
        ended.
        """
        end = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._done.is_set():
            left = TICK_S if end is None else end - time.monotonic()
            if left <= 0 or self._interrupted:
                return False
            self._done.wait(min(left, TICK_S))
        return True

    def interrupt(self) -> None:
        """Make `run` and `wait` return soon. Signal handlers may call this method only: it takes no lock."""
        self._interrupted = True

    def stop(self) -> None:
        """End everything: threads, network, recording, source. A second call does nothing."""
        self._stop.set()
        self._end()
        self._feed.mailbox.close()
        if self._recorder is not None or self._keeper is not None:
            self._feed.finish()
            ended(self._threads[:1], LAST_READ_S)
        self._feed.close()
        self._flight.wake()
        current = threading.current_thread()
        waiting = [thread for thread in self._threads if thread.is_alive() and thread is not current]
        for thread in waiting:
            thread.join(LAST_FRAME_S)
        self._coding.close()
        for thread in waiting:
            thread.join(JOIN_S)
        if self._recorder is not None:
            self._recorder.close()
        if self._own_keeper is not None:
            self._own_keeper.close()
        self._network.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *exc: object) -> None:
        self.stop()

    def status(self) -> dict[str, Any]:
        """The status, as sent once a second on the status key (docs/live.md lists the fields)."""
        parts = {
            **self._coding.state(),
            "path": self._sending.adapting.report(),
            "flight": self._flight.state(),
            "refinements": self._refining.state(),
            "errors": dict(self._once.counts),
            "preparing": self._changes.preparing,
            "recording": None if self._recorder is None else self._recorder.state(),
            "past": None if self._keeper is None else self._keeper.state(),
            "certificate": self._network.certificate(),
            "gate": self._network.gate(),
            "matching": self._sending.matching,
            "ended": self._done.is_set(),
        }
        return self._board.status(self.settings, self._feed, parts)

    def change(self, /, **changes: Unpack[SettingChanges]) -> Applied:
        """Change settings between two frames, all of them or none. If the new codec needs a process, the old codec
        encodes until that process is ready.

        Raises SettingsError or UnknownNameError.
        """
        return self._changes.change(dict(changes))

    def reset(self) -> Applied:
        """Return to the settings with which the publisher was made, between two frames.

        Raises SettingsError or MissingExtraError if they cannot be used now.
        """
        return self._changes.reset()

    def request_key(self) -> bool:
        """Make the next message a key frame. Requests within half a second are merged. True: there already was one."""
        return self._sending.request_key()

    def _runs(self) -> bool:
        return self._begun and not self._done.is_set()

    def _end(self) -> None:
        self._done.set()
        self._tell_now.set()

    # --- the source thread ------------------------------------------------------------------------------------------

    def _feed_frames(self) -> None:
        try:
            self._feed.run(wait=self._every)
        except BaseException as error:  # a panic of native code is not an Exception
            if not self._stop.is_set():
                logger.warning("the source ended: %s", error)
                self._failure = self._failure or told(error)
        finally:
            self._feed.mailbox.close()

    # --- the encode thread ------------------------------------------------------------------------------------------

    def _encode_frames(self) -> None:
        try:
            sender = self._declare(self._network.open(self._stop))
            self._opened.set()
            self._sending.run(sender)
        except BaseException as error:  # a panic of native code is not an Exception
            if not self._stop.is_set():
                self._failure = self._failure or told(error)
        finally:
            self._refining.close()
            try:
                for one in reversed(self._declared):  # the token first: receivers see the end after the last message
                    one.close()
            finally:
                self._opened.set()
                self._end()

    def _declare(self, transport: Transport) -> Sender:
        keys = self.keys
        self._declared += self._desk.declare(transport)
        if self._own_keeper is not None:
            self._declared += answers_of(self._own_keeper, lambda: self).declare(transport)
        priority = Priority.EVERY_FRAME if self._every else Priority.FRAMES
        sender = transport.sender(keys.frame, priority, self._matched)
        self._sending.matching = sender.matching
        if self._originals is not None:
            self._originals.declare(transport)
            self._declared.append(self._originals)
        self._declared += [sender, transport.token(keys.alive)]
        return sender

    # --- the status thread ------------------------------------------------------------------------------------------

    def _tell_status(self) -> None:
        while not self._opened.wait(1.0):
            pass
        transport = self._network.transport
        if transport is None or self._failure is not None:
            return
        try:
            sender = transport.sender(self.keys.status, Priority.STATUS)
            while True:
                self._tell_now.wait(STATUS_S)
                self._tell_now.clear()
                self._desk.tell()
                ended = self._done.is_set()
                sender.put(self._board.packed(self.status()))
                if ended:
                    return
        except TransportError as error:
            if not self._stop.is_set():
                self._once.add("status errors", error)

    # --- handlers, in threads of the transport ----------------------------------------------------------------------

    def _matched(self, matching: bool) -> None:
        logger.info("%s: %s", self.keys.prefix, "a receiver is connected" if matching else "no receiver is connected")
        if matching:
            self._sending.request_key()
        self._sending.matching = matching

    def _worker_failed(self, error: WorkerError) -> None:
        self._once.add(f"worker {error.cause}", error)
        self.request_key()


__all__ = ["Publisher", "Rate"]
