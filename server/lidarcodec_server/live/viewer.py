"""A viewer of a live stream. It gets the newest frame when it has acknowledged the last one. All in the event loop.

A WebSocket gives no useful back-pressure: if a client does not read, the buffers of two kernels and two libraries hold
seconds of data while every `send` returns at once. So only acknowledgements of the client count.
"""

from __future__ import annotations

import asyncio
import json
import time
from abc import ABC, abstractmethod
from collections import deque
from typing import Any, Final, NamedTuple

from lidarcodec_server.live.chain import Coded, KeyChain
from lidarcodec_server.live.cloud_format import sensor_key
from lidarcodec_server.live.cloud_image import still_holds
from lidarcodec_server.live.options import CloudOptions, FramesOptions
from lidarcodec_server.live.view import FrameView, Work

EVENTS: Final = 32
"""Most events that wait for a viewer; with more, the oldest are dropped."""


class Parcel(NamedTuple):
    """What to send next: events first, some of them as JSON already, then the bytes of frame `frame`."""

    events: list[dict[str, Any] | str]
    frame: int | None = None
    data: bytes = b""


class Viewer(ABC):
    """sent: frames or messages that it got;  skipped: frames or messages that newer ones replaced"""

    kind: str
    decodes: bool

    def __init__(self, window: int) -> None:
        self.window = window
        self.sent = self.sent_bytes = 0
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS)
        self._poses: dict[str, str] = {}
        self._in_flight: deque[tuple[int, float]] = deque()
        self._changed = asyncio.Event()
        self._gives_way = asyncio.Event()

    @property
    @abstractmethod
    def skipped(self) -> int: ...

    @property
    def waited_s(self) -> float:
        """Time since the oldest frame without acknowledgement was sent; 0 if there is none."""
        return time.monotonic() - self._in_flight[0][1] if self._in_flight else 0.0

    def tell(self, event: dict[str, Any]) -> None:
        """Send an event soon, without waiting for acknowledgements."""
        self._events.append(event)
        self._changed.set()

    def locate(self, texts: dict[str, str]) -> None:
        """Tell where programs say that the sensor is, by their names, as JSON. It replaces what they said before and is
        not sent yet."""
        self._poses |= texts
        while len(self._poses) > EVENTS:
            del self._poses[next(iter(self._poses))]
        self._changed.set()

    def give_way(self) -> None:
        """Make it leave its place to another viewer."""
        self._gives_way.set()

    async def must_leave(self) -> None:
        """Wait until it must leave its place."""
        await self._gives_way.wait()

    def acknowledge(self, index: int | None) -> None:
        """It has received frame `index` and all before it. None: the oldest one without acknowledgement. Unknown frames
        are ignored.
        """
        if index is None and self._in_flight:
            self._in_flight.popleft()
        elif any(one == index for one, _ in self._in_flight):
            while self._in_flight.popleft()[0] != index:
                pass
        self._changed.set()

    async def next(self, work: Work) -> Parcel:
        """Wait for something to send, and return it. A frame in it counts as sent."""
        while True:
            self._changed.clear()
            events: list[dict[str, Any] | str] = [self._events.popleft() for _ in range(len(self._events))]
            events += self._poses.values()
            self._poses.clear()
            pause_s = self._pause_s()
            if len(self._in_flight) < self.window and pause_s <= 0:
                parcel = await self._next(events, work)
                if parcel.frame is not None:
                    self._in_flight.append((parcel.frame, time.monotonic()))
                    self.sent += 1
                    self.sent_bytes += len(parcel.data)
                if parcel.frame is not None or parcel.events:
                    return parcel
            elif events:
                return Parcel(events)
            try:
                await asyncio.wait_for(self._changed.wait(), pause_s if pause_s > 0 else None)
            except TimeoutError:
                continue

    @abstractmethod
    async def _next(self, events: list[dict[str, Any] | str], work: Work) -> Parcel:
        """Events, and the frame to send now, if there is one."""

    def _pause_s(self) -> float:
        """Seconds until the next frame may be sent."""
        return 0.0


class CloudViewer(Viewer):
    """Gets decoded frames."""

    kind, decodes = "cloud", True

    def __init__(self, options: CloudOptions) -> None:
        super().__init__(options.window)
        self.options = options
        self._slot: FrameView | None = None
        self._skipped = 0
        self._sensor_key: object = None
        self._told_sensor: dict[str, Any] | None = None
        self._due = float("-inf")

    @property
    def compares(self) -> bool:
        """Whether it also wants the frames before coding."""
        return "original" in self.options.encoding.attributes

    @property
    def skipped(self) -> int:
        """Number of frames that newer ones replaced."""
        return self._skipped

    def show(self, view: FrameView) -> None:
        """Give it a frame; it replaces one that was not sent yet."""
        self._skipped += self._slot is not None
        self._slot = view
        self._changed.set()

    async def _next(self, events: list[dict[str, Any] | str], work: Work) -> Parcel:
        view, self._slot = self._slot, None
        if view is None:
            return Parcel(events)
        if (key := self._key_of(view)) != self._sensor_key:
            self._sensor_key = key
            facts = json.loads(await view.sensor(work))
            if not self._knows(view, facts):
                self._told_sensor = facts
                events.append({"event": "sensor", **facts})
        if self.options.rate is not None:
            now, period_s = time.monotonic(), 1.0 / self.options.rate
            self._due = (now if now - self._due > period_s else self._due) + period_s
        return Parcel(events, view.frame.index, await view.encoded(self.options.encoding, work))

    def _key_of(self, view: FrameView) -> object:
        """If this changes, the sensor may have to be sent again; for coordinates its name is enough."""
        sensor = view.frame.sensor
        return sensor_key(view.frame) if self.options.encoding.form == "range" else (sensor.hash, sensor.convention)

    def _knows(self, view: FrameView, facts: dict[str, Any]) -> bool:
        """Whether the facts of a sensor that the client has hold for a frame."""
        told = self._told_sensor
        if told is None or told["hash"] != facts["hash"] or not view.frame.sensor.is_cloud:
            return told == facts
        return self.options.encoding.form == "points" or still_holds(told, view.frame)

    def _pause_s(self) -> float:
        if self.options.rate is None or self._slot is None:
            return 0.0
        return self._due - time.monotonic()


class FramesViewer(Viewer):
    """Gets messages as the vehicle sent them, and only those that it can decode."""

    kind, decodes = "frames", False

    def __init__(self, options: FramesOptions) -> None:
        super().__init__(options.window)
        self.options = options
        self._chain = KeyChain()

    @property
    def skipped(self) -> int:
        """Messages that it did not get."""
        return self._chain.skipped

    @property
    def lost(self) -> bool:
        """Whether it waits for a key message."""
        return self._chain.lost

    def offer(self, message: Coded) -> bool:
        """Add a new message. False: this viewer needs a key message to continue."""
        goes_on = self._chain.offer(message)
        self._changed.set()
        return goes_on

    async def _next(self, events: list[dict[str, Any] | str], work: Work) -> Parcel:
        message = self._chain.take()
        if message is None:
            return Parcel(events)
        return Parcel(events, message.first, message.data)
