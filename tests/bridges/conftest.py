"""A network in memory for the tests of this folder."""

from __future__ import annotations

import pytest

from lidarcodec.transport.memory import MemoryNetwork


@pytest.fixture
def network():
    """Function that opens a transport in memory."""
    memory, opened = MemoryNetwork(), []

    def end():
        opened.append(memory.transport())
        return opened[-1]

    yield end
    for one in opened:
        one.close()
