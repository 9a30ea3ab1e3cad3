"""A network in memory for the tests of this folder."""

from __future__ import annotations

import threading

import pytest

from lidarcodec.transport.memory import MemoryNetwork
from tests.transport.test_contract import eventually


@pytest.fixture
def network():
    """A network; everything on it is closed after the test, and no thread is left."""
    before = set(threading.enumerate())
    one, opened = MemoryNetwork(), []

    def transport():
        opened.append(one.transport())
        return opened[-1]

    one.end = transport
    yield one
    for end in opened:
        end.close()
    assert eventually(lambda: set(threading.enumerate()) <= before), threading.enumerate()
