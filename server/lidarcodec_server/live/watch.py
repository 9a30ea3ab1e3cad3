"""Watch: one stream while it is viewed or recorded, with one receiver and one decoder for all viewers.

The receiver's threads pass frames and messages to it; everything else belongs to the event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import Callable
from typing import Any, Final

from lidarcodec.apps.receiver.freshness import Forward
from lidarcodec.apps.receiver.receiver import Receiver
from lidarcodec.assembly.turns import TurnJoiner
from lidarcodec.errors import DecodeError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.settings import UNFILLED
from lidarcodec.transport import Transport
from lidarcodec.transport.keys import SERVER_RECEIVER, StreamKeys
from lidarcodec_server.live.chain import coded
from lidarcodec_server.live.cloud_format import Facts
from lidarcodec_server.live.located import Located
from lidarcodec_server.live.originals import Originals
from lidarcodec_server.live.view import FrameView
from lidarcodec_server.live.viewer import CloudViewer, FramesViewer, Viewer
from lidarcodec_server.told import known_settings

logger = logging.getLogger(__name__)

Tap = Callable[[bytes], object]
"""Gets the bytes of every message, in the receiver's thread; must be quick."""
TICK_S: Final = 0.25
STALE_S: Final = 2.0
"""A stream without messages for so long is stale."""
STALE_AGAIN_S: Final = 5.0
GROUP_PACE: Final = 0.95
"""Frames of a group arrive together and are shown one after the other, a little faster than they were measured."""
MAX_GROUP_S: Final = 5.0
SLOW_KEY_S: Final = 2.0
"""Shortest time between two requests for key frames for viewers that fell behind: a key frame is larger for all."""


class Watch:
    """One stream.

    viewers: its viewers;  last, last_at: the newest decoded frame and its arrival by the monotonic clock
    """

    def __init__(self, keys: StreamKeys, transport: Transport, loop: asyncio.AbstractEventLoop) -> None:
        self.keys = keys
        self.viewers: set[Viewer] = set()
        self.last: FrameView | None = None
        self.last_at = float("-inf")
        self._loop = loop
        self._decoders = 0
        self._originals: Originals | None = None
        self.renew(transport)
        self._taps: tuple[Tap, ...] = ()
        self._waiting: set[asyncio.Future[FrameView]] = set()
        self._stream_id: int | None = None
        self._heard_at = time.monotonic()
        self._stale_told = float("-inf")
        self._slow_key_at = float("-inf")
        self._told: dict[str, Any] = {}
        self._status_read: dict[str, Any] | None = None
        self._group: Message | None = None
        self._group_ns = 0
        self._shown_group: Message | None = None
        self._shown_from = 0.0
        self._later: list[asyncio.TimerHandle] = []
        self._passes_on = False
        self._decoded_forward, self._passed_forward = Forward(), Forward()

    def renew(self, transport: Transport) -> None:
        """Make a new receiver, without starting it."""
        self._transport = transport
        self._turns = TurnJoiner()
        if self._originals is not None:
            self._compare(wanted=False)
            self._compare(wanted=True)
        self.receiver = Receiver(
            self.keys,
            SERVER_RECEIVER,
            self._decoded,
            self._came,
            lambda: None,
            transport=transport,
            decoding=self._decoders > 0,
        )
        self._located = Located(self.keys, transport, self._loop, self._locate)

    def start(self) -> None:
        """Begin to receive. May wait for the network. Raises TransportError."""
        self.receiver.start()
        self._located.start()

    def close(self) -> None:
        """Stop receiving. May wait for the network."""
        self._located.close()
        self.receiver.close()

    # --- for the hub ------------------------------------------------------------------------------------------------

    def decode(self, wanted: int) -> None:
        """Add to the number of users that want decoded frames."""
        self._decoders += wanted
        if self._decoders == 1 and wanted == 1 and not self.receiver.decoding:
            self.receiver.decoding = True
            self.receiver.request_key()

    def silent_s(self) -> float:
        """Time since the last message, whether or not the vehicle is online."""
        return time.monotonic() - self._heard_at

    def rest(self) -> None:
        """Stop decoding, because no viewer or recorder is left."""
        if not self._decoders:
            self.receiver.decoding = False
            self.last = None

    def add(self, viewer: Viewer) -> None:
        """Add a viewer."""
        self.viewers.add(viewer)
        self._told.setdefault("alive", self.receiver.alive)
        viewer.tell({"event": "alive" if self.receiver.alive else "gone"})
        settings = self._told.get("settings")
        if settings is not None:
            viewer.tell({"event": "settings", "settings": settings})
        if isinstance(viewer, FramesViewer):
            self._passes_on = True
            self.receiver.request_key()
        self._compare(wanted=self._wants_originals())
        if isinstance(viewer, CloudViewer) and self.last is not None and self.last_age_s < STALE_S:
            viewer.show(self.last)

    def remove(self, viewer: Viewer) -> None:
        """Remove a viewer."""
        self.viewers.discard(viewer)
        self._passes_on = any(isinstance(one, FramesViewer) for one in self.viewers)
        self._compare(wanted=self._wants_originals())

    def _wants_originals(self) -> bool:
        return any(isinstance(one, CloudViewer) and one.compares for one in self.viewers)

    def _compare(self, *, wanted: bool) -> None:
        """Receive originals only while a viewer compares; otherwise the vehicle sends none."""
        if wanted and self._originals is None:
            self._originals = Originals(self.keys, self._transport, self._loop)
        elif not wanted and self._originals is not None:
            self._originals.close()
            self._originals = None

    def tap(self, tap: Tap) -> None:
        """Also pass every message to this function."""
        self._taps = (*self._taps, tap)
        self.receiver.request_key()

    def untap(self, tap: Tap) -> None:
        """No longer."""
        self._taps = tuple(one for one in self._taps if one is not tap)

    @property
    def last_age_s(self) -> float:
        """Time since the newest decoded frame."""
        return time.monotonic() - self.last_at

    async def newest(self, max_age_s: float, timeout_s: float) -> FrameView | None:
        """The newest frame if it is recent enough, otherwise the next one; None if none arrives in time."""
        if self.last is not None and self.last_age_s <= max_age_s:
            return self.last
        future: asyncio.Future[FrameView] = self._loop.create_future()
        self._waiting.add(future)
        try:
            return await asyncio.wait_for(future, timeout_s)
        except TimeoutError:
            return None
        finally:
            self._waiting.discard(future)

    def state(self) -> dict[str, Any]:
        """Counts and times of the receiver, and counts of the viewers."""
        return {
            **self.receiver.stats.summary(),
            "errors": dict(self.receiver.errors),
            "decoding": self.receiver.decoding,
            "viewers": {
                kind: sum(one.kind == kind for one in self.viewers) for kind in (CloudViewer.kind, FramesViewer.kind)
            },
            "rtt_ms": self.receiver.rtt_ms,
        }

    # --- in the receiver's threads ----------------------------------------------------------------------------------

    def _decoded(self, frame: Frame) -> None:
        for whole in self._turns.add(frame):
            self._take(whole)

    def _take(self, frame: Frame) -> None:
        stats, message, now_ns = self.receiver.stats, self.receiver.decoded, time.time_ns()
        latency_ms = stats.decoded(frame, now_ns)
        stream_id = None if message is None else message.stream_id
        if self._decoded_forward.goes_back(stream_id, frame.index, frame.stamp_ns, time.monotonic()):
            stats.count("stale")
            return
        codec = 0 if message is None else message.codec
        facts = Facts(stats.stream_id or 0, codec, stats.counts["missing"], latency_ms, now_ns)
        view = FrameView(frame if self._fills() else frame.with_(lattice=None), facts, self._originals)
        if message is None or message.frame_count == 1:
            self._call(self._show_now, view)
            return
        if message is not self._group:
            self._group, self._group_ns = message, frame.stamp_ns
        self._call(self._show_later, view, message, (frame.stamp_ns - self._group_ns) / 1e9)

    def _fills(self) -> bool:
        """Whether returns may be interpolated between those that were sent: not if the stream is for a program."""
        settings = (self.receiver.status or {}).get("settings")
        return not isinstance(settings, dict) or settings.get("purpose") not in UNFILLED

    def _came(self, data: bytes) -> None:
        for tap in self._taps:
            tap(data)
        self._call(self._heard, data if self._passes_on else b"")

    def _call(self, function: Callable[..., object], *values: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: the server has stopped
            self._loop.call_soon_threadsafe(function, *values)

    # --- in the event loop ------------------------------------------------------------------------------------------

    def _show_later(self, view: FrameView, group: Message, after_s: float) -> None:
        """Show the frames of a group as far apart as they were measured. The next group cancels the rest."""
        if group is not self._shown_group:
            self._shown_group, self._shown_from = group, self._loop.time()
            self._cancel()
        at = self._shown_from + GROUP_PACE * min(max(after_s, 0.0), MAX_GROUP_S)
        self._later.append(self._loop.call_at(at, self._show, view))

    def _show_now(self, view: FrameView) -> None:
        self._cancel()
        self._show(view)

    def _cancel(self) -> None:
        for handle in self._later:
            handle.cancel()
        self._later.clear()

    def _show(self, view: FrameView) -> None:
        self.last, self.last_at = view, time.monotonic()
        for future in self._waiting:
            if not future.done():
                future.set_result(view)
        for viewer in self.viewers:
            if isinstance(viewer, CloudViewer):
                viewer.show(view)

    def _heard(self, data: bytes) -> None:
        self._heard_at = time.monotonic()
        self._stale_told = float("-inf")
        self._look_for_restart()
        viewers = [one for one in self.viewers if isinstance(one, FramesViewer)]
        if not data or not viewers:
            return
        try:
            message = coded(data)
        except DecodeError as error:  # the receiver has checked it, so its header is of a kind that is unknown here
            logger.debug("a message could not be forwarded: %s", error)
            return
        if self._passed_forward.goes_back(message.stream_id, message.first, message.stamp_ns, time.monotonic()):
            self.receiver.stats.count("stale")
            return
        going_on = [viewer.offer(message) for viewer in viewers]
        if not all(going_on) and self._heard_at - self._slow_key_at >= SLOW_KEY_S:
            self._slow_key_at = self._heard_at
            self.receiver.request_key()

    def tick(self) -> None:
        """Check whether there are events to send; called every TICK_S."""
        self._look_for_restart()
        receiver, silent_s = self.receiver, time.monotonic() - self._heard_at
        self._tell_change("alive", receiver.alive, {"event": "alive" if receiver.alive else "gone"})
        status = receiver.status
        if status is not None:
            if status is not self._status_read:
                self._status_read, told = status, known_settings(status.get("settings"))
                settings = self._told.get("settings") if told is None else told.model_dump()
                self._tell_change("settings", settings, {"event": "settings", "settings": settings})
            now = receiver.stats.stream_id
            ended = status.get("ended") is True and now is not None and status.get("stream_id") == f"{now:016x}"
            self._tell_change("ended", ended, {"event": "ended"} if ended else None)
        errors = dict(receiver.errors)
        self._tell_change("errors", errors, {"event": "errors", "counts": errors} if errors else None)
        if silent_s >= STALE_S and time.monotonic() - self._stale_told >= STALE_AGAIN_S:
            self._stale_told = time.monotonic()
            self._tell({"event": "stale", "silent_s": round(silent_s, 1)})

    def _look_for_restart(self) -> None:
        now = self.receiver.stats.stream_id
        if now is not None and self._stream_id not in (None, now):
            self._tell({"event": "restarted", "stream_id": f"{now:016x}"})
        self._stream_id = now

    def _tell_change(self, what: str, value: object, event: dict[str, Any] | None) -> None:
        if self._told.get(what) != value:
            self._told[what] = value
            if event is not None:
                self._tell(event)

    def _locate(self, events: list[dict[str, Any]]) -> None:
        texts = {event["receiver"]: json.dumps(event) for event in events}
        for viewer in self.viewers:
            viewer.locate(texts)

    def _tell(self, event: dict[str, Any]) -> None:
        for viewer in self.viewers:
            viewer.tell(event)
