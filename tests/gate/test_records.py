"""What the gate reads of TLS: real handshakes, and every way in which a ClientHello can be none."""

from __future__ import annotations

import contextlib
import ssl

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidarcodec.gate.records import Direction, NotTlsError, Progress, whole_hello
from tests.gate.strangers import HELLO, hello


def record(kind: int, body: bytes) -> bytes:
    return bytes([kind, 3, 3]) + len(body).to_bytes(2, "big") + body


def in_records(message: bytes, size: int) -> bytes:
    return b"".join(record(22, message[at : at + size]) for at in range(0, len(message), size))


def test_a_hello_is_whole_with_its_last_byte_and_not_before() -> None:
    assert not any(whole_hello(HELLO[:size]) for size in range(len(HELLO)))
    assert whole_hello(HELLO)


@pytest.mark.parametrize("size", [1, 7, 100])
def test_a_hello_may_come_in_several_records(size: int) -> None:
    split = in_records(HELLO[5:], size)
    assert whole_hello(split)
    assert not whole_hello(split[:-1])


def changed(at: int, value: int) -> bytes:
    return HELLO[:at] + bytes([value]) + HELLO[at + 1 :]


@pytest.mark.parametrize(
    "data",
    [
        b"GET / HTTP/1.1\r\n",
        b"\x16\x03\x01\x00\x00",
        record(22, b"\x02\x00\x00\x01\x00"),
        record(22, b"\x01\xff\xff\xff"),
        record(21, b"\x02\x28"),
        changed(9, 2),
        HELLO + b"x",
        record(22, HELLO[5:] + b"x"),
        record(22, b"\x01\x00\x00\x05" + b"\x03\x03abc"),
    ],
)
def test_what_is_no_hello_is_refused(data: bytes) -> None:
    with pytest.raises(NotTlsError):
        whole_hello(data)


def test_a_client_without_tls_1_3_is_refused_as_zenoh_would() -> None:
    with pytest.raises(NotTlsError, match=r"no TLS 1\.3"):
        whole_hello(hello(ssl.TLSVersion.TLSv1_2))


def test_early_data_is_refused() -> None:
    """A server that knows no early data skips it, so its answers would prove nothing."""
    message = bytearray(HELLO[5:])
    at = 4 + 2 + 32
    at += 1 + message[at]
    at += 2 + int.from_bytes(message[at : at + 2], "big")
    at += 1 + message[at]
    message[at : at + 2] = (int.from_bytes(message[at : at + 2], "big") + 4).to_bytes(2, "big")
    message += b"\x00\x2a\x00\x00"
    message[1:4] = (len(message) - 4).to_bytes(3, "big")
    with pytest.raises(NotTlsError, match="extension"):
        whole_hello(record(22, bytes(message)))


@given(st.binary(max_size=300), st.integers(0, len(HELLO)))
def test_any_bytes_are_refused_or_waited_for(data: bytes, kept: int) -> None:
    with contextlib.suppress(NotTlsError):
        assert whole_hello(HELLO[:kept] + data) in (True, False)
    with contextlib.suppress(NotTlsError):
        Direction().passed(data)


@pytest.mark.parametrize("size", [1, 3, 4096])
def test_records_are_counted_however_they_are_cut(size: int) -> None:
    data = record(22, b"a" * 90) + record(20, b"\1") + record(23, b"b" * 19) + record(23, b"c" * 700)
    direction = Direction()
    assert sum(direction.passed(data[at : at + size], 19) for at in range(0, len(data), size)) == 1


def test_a_session_is_sure_when_the_server_has_answered_three_times() -> None:
    flight, alert, answer = record(23, b"s" * 600), record(23, b"a" * 19), record(23, b"t" * 100)
    progress = Progress()
    progress.from_client(HELLO)
    progress.from_client(record(23, b"too early"))
    progress.from_server(record(22, b"h") + flight)
    progress.from_server(answer)
    assert progress.turns == 0
    progress.from_client(record(23, b"c" * 50))
    progress.from_server(alert)
    assert progress.turns == 0
    for number in range(1, Progress.SESSION + 1):
        progress.from_client(record(23, b"c" * 50))
        progress.from_server(answer + answer)
        assert progress.turns == number
