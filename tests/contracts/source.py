"""What every source must do. Checks are plain functions of a source, so that a wrong one can be shown to fail.

`tests/sources/test_contract.py` runs them over `sources.table`: a new line there fails until it names an example.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from itertools import islice

import pytest

from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sources import open_source
from lidarcodec.sources.base import PacketSource

ENOUGH = 40
PROMPTLY_S = 20.0

Open = Callable[[], PacketSource]


def says_what_it_is(make: Open) -> None:
    """Sensor, counts and a label, before a packet is read."""
    with make() as source:
        assert isinstance(source.sensor, SensorModel)
        assert isinstance(source.counts, Counter)
        assert source.label
        assert source.sensor.origin in ("given", "beside", "stream", "generic", "message", "simulated")
        assert source.start_ns is None or source.start_ns > 0


def gives_packets_in_order(make: Open) -> None:
    """1206 bytes each, but for point clouds, and times that never go back."""
    with make() as source:
        packets = list(islice(source.packets(), ENOUGH))
    assert packets
    assert all(type(p) is Packet and type(p.payload) is bytes and type(p.stamp_ns) is int for p in packets)
    assert source.sensor.is_cloud or {len(p.payload) for p in packets} == {1206}
    stamps = [p.stamp_ns for p in packets]
    assert stamps == sorted(stamps)
    if source.start_ns is not None:
        assert 0 <= stamps[0] - source.start_ns < 1_000_000


def reads_the_same_twice(make: Open) -> None:
    """What is not live can be read again, from the same source and from a new one."""
    with make() as source:
        if source.live:
            return
        first = list(islice(source.packets(), ENOUGH))
        assert list(islice(source.packets(), ENOUGH)) == first
    with make() as again:
        assert list(islice(again.packets(), ENOUGH)) == first


def ends_when_it_is_closed(make: Open) -> None:
    """Also in the middle, from another thread, and when closed twice."""
    source = make()
    running = source.packets()
    next(running)
    source.close()
    source.close()
    assert list(running) == []
    assert list(source.packets()) == []
    source = make()
    ended = threading.Event()

    def read() -> None:
        for _ in source.packets():
            pass
        ended.set()

    thread = threading.Thread(target=read)
    thread.start()
    time.sleep(0.05)
    source.close()
    assert ended.wait(PROMPTLY_S)
    thread.join()


def refuses_options_it_lacks(spec: str) -> None:
    """By name, and says which there are."""
    with pytest.raises(UnknownNameError, match="'nonsense'") as caught:
        open_source(f"{spec}{'&' if '?' in spec else '?'}nonsense=1")
    assert caught.value.known


def says_when_there_is_nothing(spec: str) -> None:
    """A place that does not exist."""
    with pytest.raises((SourceError, UnknownNameError)):
        open_source(spec)


CHECKS = (says_what_it_is, gives_packets_in_order, reads_the_same_twice, ends_when_it_is_closed)
