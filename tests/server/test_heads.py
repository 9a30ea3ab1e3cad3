"""The head of a request has a limit, which holds however it comes: heads are kept whole while a request is answered."""

from __future__ import annotations

import asyncio
import contextlib

import pytest

from tests.server.test_door import POST, body_of
from tests.server.test_request_protocol import LIMIT_S, connected


def head(size: int, where: str) -> bytes:
    """A request whose head has so many bytes."""
    before, after = {
        "path": (b"GET /", b" HTTP/1.1\r\nHost: localhost\r\n\r\n"),
        "value": (b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ", b"\r\n\r\n"),
        "spaces": (b"GET / HTTP/1.1\r\nHost: localhost\r\nX:", b"x\r\n\r\n"),
        "upgrade": (
            b"GET /api/v1/streams/a/b/cloud HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\n"
            b"Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nX: ",
            b"\r\n\r\n",
        ),
    }[where]
    return before + (size - len(before) - len(after)) * (b" " if where == "spaces" else b"x") + after


@pytest.mark.parametrize("where", ["path", "value", "spaces", "upgrade"])
@pytest.mark.parametrize("size", [16_385, 70_000])
async def test_a_head_of_more_than_16_kib_is_refused_also_when_it_comes_at_once(where, size):
    """One of 70 kB was answered: only what was not there yet counted."""
    async with connected(limit_s=5.0) as (reader, writer, _):
        writer.write(head(size, where))
        with contextlib.suppress(ConnectionError):
            answer = await asyncio.wait_for(reader.read(), LIMIT_S)
            assert answer.startswith(b"HTTP/1.1 431 "), answer[:100]


async def test_heads_of_16_kib_are_answered_one_after_the_other():
    async with connected(limit_s=5.0) as (reader, writer, _):
        writer.write(2 * head(16_384, "value"))
        for _ in range(2):
            assert b" 200 " in await asyncio.wait_for(reader.readuntil(b"\r\n\r\nok"), LIMIT_S)


async def test_what_follows_a_body_in_chunks_is_as_long_at_most(monkeypatch):
    monkeypatch.setattr("tests.server.test_request_protocol.app", body_of)
    async with connected(limit_s=5.0) as (reader, writer, _):
        writer.write(POST + b"1\r\nx\r\n0\r\nX: " + 70_000 * b"x" + b"\r\n\r\n")
        with contextlib.suppress(ConnectionError):
            answer = await asyncio.wait_for(reader.read(), LIMIT_S)
            assert answer.startswith(b"HTTP/1.1 431 ")
