"""SharedSwarm: many vehicles that send the same encoded messages, so that encoding does not limit a load test.

Each vehicle has its own stream: stream id, frame indices, current time stamps, key frames on request, status, and
control keys. As a publisher does, it sends nothing without a receiver, and leaves out frames while it waits for arrival
reports. Settings cannot be changed, because nothing is encoded again.
"""

from __future__ import annotations

import dataclasses
import json
import os
import threading
import time
from typing import Any

from lidarcodec.apps.ending import ended
from lidarcodec.apps.publisher.arrivals import listen_for_arrivals
from lidarcodec.apps.publisher.flight import Flight
from lidarcodec.apps.reports import read_report
from lidarcodec.apps.swarm import NOMINAL_HZ
from lidarcodec.errors import SettingsError
from lidarcodec.message import Message
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.ratecontrol.choosing import without_auto
from lidarcodec.sensor_model import SensorModel
from lidarcodec.settings import StreamSettings
from lidarcodec.transport import Endpoints, Transport, open_transport
from lidarcodec.transport.answering import answered
from lidarcodec.transport.base import Closeable, Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.wire import checksum_of, pack

STATUS_S = 1.0


def encoded(sensor: SensorModel, packets: list[Packet], settings: StreamSettings) -> list[Message]:
    """Messages of these packets, beginning with a key frame. They are sent repeatedly."""
    encoder = StreamEncoder(settings)
    messages = [message for frame in frames_of(packets, sensor, settings.framing) for message in encoder.encode(frame)]
    return messages + encoder.flush()


class _Vehicle:
    """One stream: its position in the messages, and counts of sent messages."""

    def __init__(self, name: str, messages: list[Message], settings: StreamSettings, transport: Transport) -> None:
        self._keys, self._messages, self._settings = StreamKeys(name), messages, settings
        self._stream_id = int.from_bytes(os.urandom(8), "little")
        self._flight = Flight()
        self._place = self._index = 0
        self._sent_as: dict[int, int] = {}  # index in the messages -> index in the stream, since the first message
        self._sent = self._put = self._bytes = self._key_frames = self._replaced = self._no_receiver = 0
        self._last: int | None = None
        self._key_wanted = False
        self._frames = transport.sender(self._keys.frame, Priority.FRAMES)
        self._status = transport.sender(self._keys.status, Priority.STATUS)
        self._declared: list[Closeable] = [
            self._frames,
            self._status,
            *listen_for_arrivals(transport, self._keys, self._flight, self._receiver_came),
            transport.listen(self._keys.report(), self._reported),
            transport.answer(self._keys.control_get, answered(self._answer_get)),
            transport.answer(self._keys.control_set, answered(self._answer_set)),
            transport.answer(self._keys.control_keyframe, answered(self._answer_keyframe)),
            transport.token(self._keys.alive),
        ]

    def send(self) -> None:
        """Send the next message, with the current time as stamp, if somebody receives it and the path is free.

        Otherwise its frames are left out, and it is sent with the index of a later frame.
        """
        if self._key_wanted or self._place == len(self._messages):
            self._place, self._key_wanted = 0, False
            self._sent_as.clear()
        message = self._messages[self._place]
        index = self._index
        self._index += message.frame_count
        if not self._frames.matching:
            self._no_receiver += message.frame_count
            return
        if not self._flight.wait(0.0):
            self._replaced += message.frame_count
            return
        self._sent_as[message.frame_index] = index
        own = dataclasses.replace(
            message,
            stream_id=self._stream_id,
            frame_index=index,
            stamp_ns=time.time_ns(),
            needs=None if message.needs is None else self._sent_as[message.needs],
        )
        data = pack(own)
        self._flight.sent(index, checksum_of(data), len(data), message.frame_count, key=message.key)
        self._frames.put(data)
        self._place += 1
        self._sent += message.frame_count
        self._put += 1
        self._last = index + message.frame_count - 1
        self._bytes += len(data)
        self._key_frames += message.key

    def tell(self) -> None:
        """Send the status."""
        self._status.put(json.dumps(self.status()).encode())

    def status(self) -> dict[str, Any]:
        """The status of a stream without an encoder."""
        return {
            "vehicle": self._keys.vehicle,
            "sensor": self._keys.sensor,
            "stream_id": f"{self._stream_id:016x}",
            "stamp_ns": time.time_ns(),
            "settings": self._settings.model_dump(),
            "codec": without_auto(self._settings).codec,
            "matching": self._frames.matching,
            "assembled": self._index,
            "replaced": self._replaced,
            "no_receiver": self._no_receiver,
            "left_out": 0,
            "frames": self._sent,
            "messages": self._put,
            "bytes": self._bytes,
            "key_frames": self._key_frames,
            "frame_index": self._last,
            "flight": self._flight.state(),
            "ended": False,
        }

    def close(self) -> None:
        for one in reversed(self._declared):
            one.close()

    def _receiver_came(self) -> None:
        self._key_wanted = True

    def _reported(self, key: str, data: bytes) -> None:
        rtt_ms = (read_report(data) or {}).get("rtt_ms")
        if isinstance(rtt_ms, int | float):
            self._flight.round_trip(key.rpartition("/")[2], rtt_ms / 1e3)

    def _answer_get(self, query: dict[str, Any]) -> dict[str, Any]:
        if "ping" in query:
            return {"ping": query["ping"], "busy": self._flight.busy, "time_ns": time.time_ns()}
        return {"settings": self._settings.model_dump(), "status": self.status()}

    def _answer_set(self, query: dict[str, Any]) -> dict[str, Any]:
        raise SettingsError(
            "a vehicle of a swarm with --shared sends frames that are already encoded: its settings cannot be changed"
        )

    def _answer_keyframe(self, query: dict[str, Any]) -> dict[str, Any]:
        merged, self._key_wanted = self._key_wanted, True
        return {"first_frame": self._index, "merged": merged}


class SharedSwarm:
    """Vehicles that send the same messages. A context manager."""

    def __init__(
        self,
        names: list[str],
        messages: list[Message],
        settings: StreamSettings,
        *,
        rate: float = NOMINAL_HZ,
        endpoints: Endpoints | None = None,
    ) -> None:
        self._names, self._messages, self._settings = names, messages, settings
        self._every_s, self._endpoints = 1.0 / rate, endpoints
        self._vehicles: list[_Vehicle] = []
        self._transport: Transport | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="lidarcodec swarm", daemon=True)
        self.failure: Exception | None = None

    def start(self) -> None:
        """Open the network and begin. Raises TransportError if it cannot be opened, or `stop` was called."""
        self._transport = open_transport(self._endpoints, stop=self._stop)
        self._vehicles = [_Vehicle(name, self._messages, self._settings, self._transport) for name in self._names]
        self._thread.start()

    def interrupt(self) -> None:
        """Make `start` return soon. For signal handlers."""
        self._stop.set()

    def stop(self) -> None:
        """End everything. A second call does nothing."""
        self._stop.set()
        ended([self._thread])
        for vehicle in self._vehicles:
            vehicle.close()
        if self._transport is not None:
            self._transport.close()

    def statuses(self) -> list[dict[str, Any]]:
        """The status of every vehicle."""
        return [vehicle.status() for vehicle in self._vehicles]

    def __enter__(self) -> SharedSwarm:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()

    def _run(self) -> None:
        """Send the messages of each vehicle when they are due. The vehicles are spread evenly over the time of one
        frame.
        """
        try:
            count, begin, told_s = len(self._vehicles), time.monotonic(), time.monotonic()
            turn = 0
            while True:
                due_s = begin + turn * self._every_s / count
                if self._stop.wait(max(0.0, due_s - time.monotonic())):
                    return
                self._vehicles[turn % count].send()
                turn += 1
                if time.monotonic() - told_s >= STATUS_S:
                    told_s = time.monotonic()
                    for vehicle in self._vehicles:
                        vehicle.tell()
        except Exception as error:
            self.failure = error
