"""What a user would lose here: the metadata of a live Ouster, or an answer in time when something else is there."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from lidarcodec.errors import CalibrationError
from lidarcodec.sensors.models.ouster.sensor import bare_sensors
from lidarcodec.sources import ouster_http
from lidarcodec.sources.ouster_http import LIVE_ANSWER_S, PATH, metadata_over_http, with_metadata
from tests.sensors.ouster_packets import as_json, flat_metadata, nested_metadata

METADATA = as_json(nested_metadata(flat_metadata()))
HOST = "127.0.0.1"


@contextmanager
def sensor(answer: Callable[[BaseHTTPRequestHandler], None]) -> Iterator[int]:
    """Port of an HTTP server that answers so."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            answer(self)

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer((HOST, 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def sends(body: bytes, status: int = 200) -> Callable[[BaseHTTPRequestHandler], None]:
    """An answer of that body."""

    def answer(request: BaseHTTPRequestHandler) -> None:
        right = request.path == PATH
        request.send_response(status if right else 404)
        request.send_header("Content-Length", str(len(body)))
        request.end_headers()
        request.wfile.write(body)

    return answer


def chunked(request: BaseHTTPRequestHandler) -> None:
    """The metadata in chunks, on a connection that stays open."""
    request.send_response(200)
    request.send_header("Transfer-Encoding", "chunked")
    request.end_headers()
    for start in range(0, len(METADATA), 1000):
        part = METADATA[start : start + 1000]
        request.wfile.write(f"{len(part):x}\r\n".encode() + part + b"\r\n")
    request.wfile.write(b"0\r\n\r\n")
    time.sleep(0.3)


def test_a_sensor_gives_its_metadata() -> None:
    for answer in (sends(METADATA), chunked):
        with sensor(answer) as port:
            assert metadata_over_http(HOST, port) == METADATA


def dripping(request: BaseHTTPRequestHandler) -> None:
    request.send_response(200)
    request.end_headers()
    try:
        while True:
            request.wfile.write(b" ")
            request.wfile.flush()
            time.sleep(0.02)
    except OSError:
        pass


def endless(request: BaseHTTPRequestHandler) -> None:
    request.send_response(200)
    request.end_headers()
    try:
        while True:
            request.wfile.write(b" " * 10_000)
    except OSError:
        pass


def not_http(request: BaseHTTPRequestHandler) -> None:
    request.wfile.write(b"SSH-2.0-OpenSSH\r\n")
    request.close_connection = True


def beyond_any_number(request: BaseHTTPRequestHandler) -> None:
    request.send_response(200)
    request.send_header("Content-Length", "1" + "0" * 30)
    request.end_headers()
    request.close_connection = True


def chunk_beyond_any_number(request: BaseHTTPRequestHandler) -> None:
    request.send_response(200)
    request.send_header("Transfer-Encoding", "chunked")
    request.end_headers()
    request.wfile.write(b"f" * 40 + b"\r\nabc\r\n0\r\n\r\n")


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (sends(METADATA, 404), "it answered with status 404"),
        (sends(METADATA, 302), "it answered with status 302"),
        (sends(b""), "it is malformed JSON"),
        (sends(b'{"error": "starting"}'), "it lacks the list beam_altitude_angles"),
        (sends(b" " * 70_000 + METADATA), "at most 65,536 are allowed"),
        (dripping, "timed out"),
        (endless, "the answer is larger than 131,072 bytes"),
        (not_http, "SSH"),
        (beyond_any_number, "cannot fit 'int'"),
        (chunk_beyond_any_number, "cannot fit 'int'"),
    ],
)
def test_other_answers_are_refused_in_time(answer: Callable[[BaseHTTPRequestHandler], None], message: str) -> None:
    with sensor(answer) as port:
        begin = time.monotonic()
        with pytest.raises(
            CalibrationError, match=f"no metadata from http://{HOST}:{port}{PATH}: .*{message}"
        ) as raised:
            metadata_over_http(HOST, port, answer_s=0.5 if answer is dripping else 60.0)
        assert time.monotonic() - begin < 20
        assert "\n" not in str(raised.value)


def test_where_nothing_listens_there_is_no_sensor() -> None:
    with socket.create_server((HOST, 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(CalibrationError, match="Connection refused"):
        metadata_over_http(HOST, port)
    with pytest.raises(CalibrationError, match=r"no metadata from http://no-such-sensor\.invalid/api"):
        metadata_over_http("no-such-sensor.invalid")


@pytest.mark.parametrize("host", ["", "a b", "http://10.5.5.86", "user@host", "host\r\nX: y", "x" * 70_000])
def test_names_that_are_no_host_are_refused(host: str) -> None:
    with pytest.raises(CalibrationError, match=r"is not the name or address of a sensor|no metadata from"):
        metadata_over_http(host)


def test_no_address_beyond_the_networks_of_this_machine_is_asked(caplog: pytest.LogCaptureFixture) -> None:
    """The address is what packets claim: anybody's, who would be asked in the name of this machine."""
    bare = bare_sensors()["ouster-16-legacy"]
    began = time.monotonic()
    assert with_metadata(bare, bytes([198, 51, 100, 7]), "UDP") is bare
    assert time.monotonic() - began < LIVE_ANSWER_S
    assert "this machine is not in its network; give the metadata with --calibration FILE" in caplog.text


def test_whatever_a_host_answers_the_packets_are_read_on(caplog: pytest.LogCaptureFixture) -> None:
    """The packets name the host. One that answers with a size beyond any number ended `publish`, and its recording."""
    bare = bare_sensors()["ouster-16-legacy"]
    with sensor(beyond_any_number) as port, pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            ouster_http, "metadata_over_http", lambda host, **given: metadata_over_http(host, port, **given)
        )
        assert with_metadata(bare, bytes([127, 0, 0, 1]), "UDP") is bare
    assert "no metadata from" in caplog.text


def test_a_sensor_nearby_is_asked() -> None:
    with sensor(sends(METADATA)) as port:
        assert metadata_over_http(HOST, port, near=True) == METADATA
