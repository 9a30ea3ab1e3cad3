"""One server for all tests of a file, and its vehicle."""

from __future__ import annotations

import pytest

from tests.server.live import running
from tests.transport.test_contract import eventually


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with running(tmp_path_factory.mktemp("server"), max_viewers=12, ack_limit_s=60.0) as one:
        one.hub.linger_s = 0.1
        yield one


@pytest.fixture
def vehicle(server):
    """A vehicle at 20 Hz whose stream the server knows; afterwards nobody watches it."""
    with server.publisher() as one:
        assert server.seen()
        yield one
    assert eventually(lambda: not server.hub.watches())
