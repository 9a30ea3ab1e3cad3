"""A malformed request for a WebSocket keeps no connection open, and does not hold up the end of the server."""

from __future__ import annotations

import signal
import socket

import pytest

from tests.server.floods import upgrade
from tests.server.test_live_process import eventually
from tests.server.test_processes import Server

GOOD = upgrade("car-7/roof/cloud")
MALFORMED = {
    "with a body": GOOD[:-2] + b"Content-Length: 5\r\n\r\nhello",
    "with a body in chunks": GOOD[:-2] + b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    "with a long path": upgrade("a" * 9000 + "/roof/cloud"),
    "with a long header": GOOD[:-2] + b"X: " + b"a" * 9000 + b"\r\n\r\n",
}


@pytest.mark.timeout(120)
def test_a_request_for_a_socket_that_is_none_keeps_no_connection(tmp_path):
    """Nor does it when its client went at once: otherwise a few hundred of them keep everybody out for good."""
    server = Server(None, f"sqlite:///{tmp_path / 'server.db'}", LIDARCODEC_SERVE_MAX_CONNECTIONS_A_HOST="4")
    address = "127.0.0.1", server.client.base_url.port
    try:
        assert eventually(lambda: server.get("/healthz"))
        for _ in range(8):
            for request in MALFORMED.values():
                with socket.create_connection(address, 10) as one:
                    one.sendall(request)
        server.client.close()
        server.client = type(server.client)(base_url=server.client.base_url, timeout=10)
        assert eventually(lambda: server.get("/healthz"))
        for name, request in MALFORMED.items():
            with socket.create_connection(address, 10) as one:
                one.sendall(request)
                assert one.recv(64).startswith(b"HTTP/1.1 400 "), name
    finally:
        code, complaints = server.end(signal.SIGTERM)
    assert code == 0, complaints


@pytest.mark.timeout(120)
def test_no_request_for_a_socket_makes_the_end_of_a_server_fail(tmp_path):
    server = Server(None, f"sqlite:///{tmp_path / 'server.db'}")
    address = "127.0.0.1", server.client.base_url.port
    assert eventually(lambda: server.get("/healthz"))
    held = [socket.create_connection(address, 10) for _ in MALFORMED]
    for one, request in zip(held, MALFORMED.values(), strict=True):
        one.sendall(request)
    assert eventually(lambda: server.get("/healthz"))
    code, complaints = server.end(signal.SIGTERM)
    for one in held:
        one.close()
    assert (code, complaints) == (0, "")
