"""The two ends of a link under test, each a process: our own, and the plain ones that they are compared with.

    python -m benchmarks.link_ends publish|receive '{"policy": "auto", ...}'

Each prints a JSON object a line: `publish` its status five times a second, `receive` a line a frame. Plain policies put
every frame as it comes, at a fixed quality, with one of the library's answers to congestion.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

import lidarcodec
from benchmarks.scenes import FRAMING
from lidarcodec.apps.past.keeper import Keep
from lidarcodec.apps.receiver.stats import last_packet_ns
from lidarcodec.errors import MissingReferenceError
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import settings_from
from lidarcodec.sources import open_source
from lidarcodec.sources.base import PacketSource
from lidarcodec.sources.pacing import PacedSource
from lidarcodec.transport.endpoints import session_options
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.units import FRAME_PACKETS, RANGE_STEP_M
from lidarcodec.wire import pack, unpack

KEYS = StreamKeys("link", "lidar")
PLAIN = {
    "DROP": zenoh.CongestionControl.DROP,
    "BLOCK": zenoh.CongestionControl.BLOCK,
    "BLOCK_FIRST": zenoh.CongestionControl.BLOCK_FIRST,
}
KEEP_BYTES = 8 * 10**9
STATUS_S = 0.2
TOLD = ("rate", "path", "replaced", "left_out", "frames", "put_ms", "refinements")
COMPARED = 5
"""Every fifth frame is compared with the original."""


class Turns(PacketSource):
    """The whole frames of a capture, in memory, so that frame i of a loop is frame i modulo their number."""

    def __init__(self, spec: str | Path) -> None:
        with open_source(spec) as source:
            packets = list(source.packets())
            super().__init__(source.sensor)
        self._packets = packets[: len(packets) // FRAME_PACKETS * FRAME_PACKETS]

    def packets(self) -> Iterator[Packet]:
        """Packets in order, once."""
        return iter(self._packets)


def looped(spec: str | Path) -> PacedSource:
    """The capture over and over, at its own pace, stamped now."""
    return PacedSource(Turns(spec), loop=True, restamp=True)


def say(**values: Any) -> None:
    """One line, whole, at once."""
    os.write(1, json.dumps(values).encode() + b"\n")


def stopped() -> threading.Event:
    """Set by SIGTERM."""
    event = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: event.set())
    return event


def session(**endpoints: list[str]) -> zenoh.Session:
    """A session as ours are, with the library's own buffers and queues."""
    config = zenoh.Config()
    mode = "client" if endpoints.get("connect") else "peer"
    options = session_options(mode, endpoints.get("listen", []), endpoints.get("connect", []))
    for path, value in (options | {"connect/timeout_ms": 20_000}).items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def publish(*, policy: str, source: str, listen: str, settings: dict[str, Any], keep: str | None = None) -> None:
    """Publish a looped capture until SIGTERM. keep: folder of what is kept"""
    stop, told = stopped(), 0
    if policy in PLAIN:
        publish_plain(policy, source, listen, settings, stop)
        return
    endpoints = lidarcodec.Endpoints.of(listen=listen)
    with lidarcodec.Publisher(
        looped(source),
        settings_from({"framing": FRAMING, **settings}),
        vehicle=KEYS.vehicle,
        sensor=KEYS.sensor,
        endpoints=endpoints,
        keep=None if keep is None else Keep(Path(keep), KEEP_BYTES),
    ) as publisher:
        while not stop.wait(STATUS_S):
            status = publisher.status()
            number = status["flight"]["arrive_ms"]["count"] - told
            delays = publisher._flight.arrive_ms.recent()[-number:] if number else []
            say(at=time.time(), arrive_ms=delays, **{name: status[name] for name in TOLD})
            told += number
        status = publisher.status()
    say(final={name: status[name] for name in ("flight", "encode_ms", "put_ms", "replaced", "frames", "errors")})


def publish_plain(policy: str, source: str, listen: str, settings: dict[str, Any], stop: threading.Event) -> None:
    """Encode and put every frame in the loop that reads them."""
    encoder, paced = StreamEncoder(settings_from({"framing": FRAMING, **settings})), looped(source)
    with session(listen=[listen]) as opened:
        publisher = opened.declare_publisher(KEYS.frame, congestion_control=PLAIN[policy])
        for frame in frames_of(paced.packets(), paced.sensor, FRAMING):
            for message in encoder.encode(frame):
                publisher.put(pack(message))
            if stop.is_set():
                break


def receive(*, policy: str, source: str, connect: str, keep: str | None = None) -> None:
    """Say of each frame when it was there, how late, and how far from the original, until SIGTERM.

    keep: folder for the frames that are compared, pickled, as a viewer sees them
    """
    stop = stopped()
    turns = Turns(source)
    originals = [frame.range for frame in frames_of(turns.packets(), turns.sensor, FRAMING)]
    say(ready=True)
    if policy in PLAIN:
        receive_plain(connect, originals, stop)
        return
    with lidarcodec.subscribe(KEYS.prefix, connect=connect) as live:
        while not stop.is_set():
            frame = live.next(0.2)
            if frame is not None:
                tell(frame, originals, live.stats.latency_ms.recent()[-1:])
                if keep is not None and frame.index % COMPARED == 0:
                    (Path(keep) / f"{frame.index}.pickle").write_bytes(pickle.dumps(filled(frame)))
        say(summary=live.summary())


def receive_plain(connect: str, originals: list[np.ndarray], stop: threading.Event) -> None:
    """Take the newest from a ring of one, and decode it."""
    decoder = StreamDecoder()
    with session(connect=[connect]) as opened:
        subscriber = opened.declare_subscriber(KEYS.frame, zenoh.handlers.RingChannel(1))
        while not stop.is_set():
            sample = subscriber.try_recv()
            if sample is None:
                time.sleep(0.001)
                continue
            with contextlib.suppress(MissingReferenceError):  # until the first key frame
                for frame in decoder.decode(unpack(sample.payload.to_bytes())):
                    tell(frame, originals, [(time.time_ns() - last_packet_ns(frame)) / 1e6])


def tell(frame: Frame, originals: list[np.ndarray], late: list[float]) -> None:
    """A line about a frame."""
    now, rmse_m, worst_m = time.time(), None, None
    if frame.index % COMPARED == 0:
        original = originals[frame.index % len(originals)]
        both = (original > 0) & (frame.range > 0)
        error = original[both].astype(np.int32) - frame.range[both]
        rmse_m = round(float(np.sqrt(np.mean(np.square(error, dtype=np.float64)))) * RANGE_STEP_M, 4)
        worst_m = round(float(np.abs(error).max(initial=0)) * RANGE_STEP_M, 3)
    step = None if frame.lattice is None else round(frame.width / len(frame.lattice), 1)
    say(at=now, index=frame.index, latency_ms=late[0] if late else None, rmse_m=rmse_m, worst_m=worst_m, step=step)


if __name__ == "__main__":
    {"publish": publish, "receive": receive}[sys.argv[1]](**json.loads(sys.argv[2]))
