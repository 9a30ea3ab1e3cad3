"""Pairs of transports on the same network: in memory, and Zenoh over a free loopback port."""

from __future__ import annotations

import secrets
import socket

import pytest

from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.memory import MemoryNetwork


def free_port() -> int:
    """A port that nobody has now, below those that the kernel gives to whoever asks for any: nobody is given it."""
    while True:
        port = 16_384 + secrets.randbelow(16_384)
        with socket.socket() as stream, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams:
            try:
                stream.bind(("127.0.0.1", port))
                datagrams.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port


@pytest.fixture(params=["memory", "zenoh"])
def network(request):
    """Function that opens a transport; all of one test are on the same network and are closed after it."""
    opened = []
    port, memory = free_port(), MemoryNetwork()

    def open_one():
        one = memory.transport() if request.param == "memory" else open_transport(Endpoints(loopback_port=port))
        opened.append(one)
        return one

    yield open_one
    for one in opened:
        one.close()
