"""Where the monitor's results go: JSON on Zenoh, and an MCAP file that Foxglove opens."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from lidarcodec.interop import foxglove
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Priority

WORLD = foxglove.WORLD
ANY_OBJECT = json.dumps({"type": "object"}).encode()


class ZenohOutput:
    """Puts alerts, as they come, on `lidarcodec/v2x/NAME/alert`, and the state once a second on `.../state`."""

    def __init__(self, name: str, endpoints: Endpoints, stop: threading.Event) -> None:
        self._transport = open_transport(endpoints, stop=stop)
        prefix = f"lidarcodec/v2x/{name}"
        self._alerts = self._transport.sender(f"{prefix}/alert", Priority.REAL_TIME)
        self._state = self._transport.sender(f"{prefix}/state", Priority.STATUS)

    def alert(self, event: dict[str, Any]) -> None:
        self._alerts.put(json.dumps(event).encode())

    def state(self, state: dict[str, Any], things: np.ndarray) -> None:
        self._state.put(json.dumps(state).encode())

    def close(self) -> None:
        self._transport.close()


class McapOutput:
    """Topics `alerts` and `state` (JSON), and `things`: the points that stand in zones, in the common frame.

    Each message is passed to the system at once, so a kill loses none. If the disk fails, the file ends there, and all
    else goes on.  fault: why it ended; None if it did not
    """

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        """Raises OSError, also if there is such a file already: it may hold alerts."""
        self._path, self._say = path, say
        self.fault: OSError | None = None
        try:
            self._file = path.open("xb")
        except FileExistsError:
            raise FileExistsError(f"{path} exists: choose another name, or remove it") from None
        self._mcap = Writer(self._file, chunk_size=1)  # a message each
        self._mcap.start(library="lidarcodec v2x_monitor")
        schema = self._mcap.register_schema("v2x", "jsonschema", ANY_OBJECT)
        self._alerts = self._mcap.register_channel("alerts", "json", schema)
        self._states = self._mcap.register_channel("state", "json", schema)
        cloud = self._mcap.register_schema(foxglove.POINT_CLOUD.name, foxglove.ENCODING, foxglove.POINT_CLOUD.data)
        self._things = self._mcap.register_channel("things", foxglove.ENCODING, cloud)

    def _add(self, channel: int, stamp_ns: int, data: bytes) -> None:
        if self.fault is not None:
            return
        try:
            self._mcap.add_message(channel, stamp_ns, data, stamp_ns)
            self._file.flush()
        except OSError as error:
            self._end(error)

    def _end(self, error: OSError) -> None:
        self.fault = OSError(error.errno, f"{self._path} ends early: {error.strerror}")
        self._say(f"{self._path} cannot be written any more: {error.strerror}. Alerts go on without it")

    def alert(self, event: dict[str, Any]) -> None:
        self._add(self._alerts, event["stamp_ns"], json.dumps(event).encode())

    def state(self, state: dict[str, Any], things: np.ndarray) -> None:
        stamp_ns = state["stamp_ns"]
        self._add(self._states, stamp_ns, json.dumps(state).encode())
        points = np.zeros(len(things), foxglove.POINT_DTYPE)
        for at, axis in enumerate("xyz"):
            points[axis] = things[:, at]
        self._add(self._things, stamp_ns, foxglove.cloud_message(stamp_ns, WORLD, points))

    def close(self) -> None:
        try:
            if self.fault is None:
                self._mcap.finish()
            self._file.close()
        except OSError as error:
            if self.fault is None:
                self._end(error)
