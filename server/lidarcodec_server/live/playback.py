"""Playback: publishes a recording as a stream of its own, in the server's process."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.publisher.source import NOMINAL_HZ
from lidarcodec.settings import StreamSettings
from lidarcodec.sources.recording import RecordingSource
from lidarcodec.transport import Transport
from lidarcodec_server.live.played_source import PlayedSource


@dataclass(frozen=True)
class PlayRequest:
    """The stream of a playback. rate: frames of 348 packets a second;  loop: start again at the end"""

    vehicle: str
    sensor: str = "lidar"
    rate: float = 10.0
    loop: bool = False
    settings: StreamSettings = field(default_factory=StreamSettings)


class Playback:
    """One playback.

    ended: set to end it;  task: finishes when it has ended
    """

    def __init__(self, request: PlayRequest) -> None:
        self.request = request
        self.ended = asyncio.Event()
        self.task: asyncio.Task[None] | None = None
        self._since_ns = time.time_ns()
        self._publisher: Publisher | None = None
        self._transport: Transport | None = None
        self._source: PlayedSource | None = None

    def start(self, file: Path, transport: Transport) -> None:
        """Begin to send. The playback owns the transport from here on. Blocks while the first packets are read.

        Raises SourceError, PacketError, SettingsError, UnknownNameError or TransportError.
        """
        request = self.request
        try:
            source = PlayedSource(RecordingSource(file), speed=request.rate / NOMINAL_HZ, loop=request.loop)
            publisher = Publisher(
                source, request.settings, vehicle=request.vehicle, sensor=request.sensor, transport=transport
            )
            publisher.start()
        except BaseException:
            transport.close()
            raise
        self._publisher, self._transport, self._source = publisher, transport, source

    @property
    def finished(self) -> bool:
        """Whether everything was sent."""
        return self._publisher is not None and self._publisher.wait(0.0)

    def stop(self) -> None:
        """End it, within the time limits of the publisher."""
        if self._publisher is not None:
            self._publisher.stop()
        if self._transport is not None:
            self._transport.close()

    def steer(self, *, position_s: float | None, paused: bool | None, rate: float | None, loop: bool | None) -> None:
        """Pause it, move it, or change its speed or loop. None leaves a value as it is. No effect before `start`."""
        if self._source is not None:
            speed = None if rate is None else rate / NOMINAL_HZ
            self._source.steer(position_s=position_s, paused=paused, speed=speed, loop=loop)

    def state(self) -> dict[str, Any]:
        """Its stream and its position."""
        status = None if self._publisher is None else self._publisher.status()
        source = self._source
        return {
            "vehicle": self.request.vehicle,
            "sensor": self.request.sensor,
            "rate": self.request.rate if source is None else round(source.speed * NOMINAL_HZ, 3),
            "loop": self.request.loop if source is None else source.loop,
            "paused": source is not None and source.paused,
            "position_s": 0.0 if source is None else round(source.position_s, 2),
            "duration_s": 0.0 if source is None else round(source.duration_s, 2),
            "since_ns": self._since_ns,
            "frames": 0 if status is None else status["frames"],
            "source": {} if status is None else status["source"],
        }
