"""Who asks nothing must not keep others from asking: connections are few, and to open one takes no token."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager

import pytest
import uvicorn
from uvicorn.server import ServerState

from lidarcodec_server.door.connections import Connections
from lidarcodec_server.door.request_protocol import RequestProtocol, Times

GET = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"
LIMIT_S = 60.0


async def app(scope, receive, send):
    """Answers after as many seconds as the query says."""
    await asyncio.sleep(float(scope["query_string"] or 0))
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
    await send({"type": "http.response.body", "body": b"ok"})


@asynccontextmanager
async def connected(limit_s=0.3, held=None, read_s=30.0):
    protocol = RequestProtocol.of(Connections() if held is None else held, Times(limit_s, read_s))
    config = uvicorn.Config(app, log_config=None, lifespan="off", timeout_keep_alive=60)
    config.load()
    state = ServerState()
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: protocol(config, state, {}), "127.0.0.1", 0)
    reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
    try:
        yield reader, writer, state
    finally:
        writer.close()
        server.close()


@pytest.mark.parametrize("sent", [b"", b"G", GET[:-2] + b"X-Slow: "], ids=["nothing", "a letter", "half the headers"])
async def test_a_connection_without_a_request_is_ended(sent):
    async with connected() as (reader, writer, state):
        writer.write(sent)
        assert await asyncio.wait_for(reader.read(), LIMIT_S) == b""
        assert not state.connections


async def test_a_request_is_answered_however_long_that_takes_and_then_the_next_one():
    async with connected(limit_s=1.0) as (reader, writer, _):
        writer.write(2 * GET.replace(b"/ ", b"/?1.2 "))
        for _ in range(2):
            await asyncio.wait_for(reader.readuntil(b"ok"), LIMIT_S)


async def test_a_body_that_nobody_reads_keeps_no_connection():
    async with connected(limit_s=1.0) as (reader, writer, _):
        writer.write(GET[:-2] + b"Content-Length: 1000\r\n\r\nx")
        await asyncio.wait_for(reader.readuntil(b"ok"), LIMIT_S)
        writer.write(b"x")
        assert await asyncio.wait_for(reader.read(), LIMIT_S) == b""


async def test_a_body_of_two_lengths_is_refused():
    """A proxy that goes by the other one would take the rest for a request of somebody else."""
    async with connected() as (reader, writer, _):
        lengths = b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n"
        writer.write(GET[:-2] + lengths + b"0\r\n\r\n" + GET)
        answer = await asyncio.wait_for(reader.read(), LIMIT_S)
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert answer.count(b"HTTP/1.1") == 1
