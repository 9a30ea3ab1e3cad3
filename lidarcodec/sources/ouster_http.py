"""The metadata of an Ouster, requested from the sensor: `GET /api/v1/sensor/metadata`, from firmware 2.1 on."""

from __future__ import annotations

import errno
import http.client
import io
import logging
import socket
import time
from ipaddress import ip_address
from typing import Final, cast

from lidarcodec.errors import CalibrationError
from lidarcodec.sensor_model import SensorModel
from lidarcodec.sensors.models.ouster.metadata import read_metadata
from lidarcodec.sensors.models.ouster.sensor import bare_sensors
from lidarcodec.untrusted.json import MAX_BYTES

logger = logging.getLogger(__name__)

PATH: Final = "/api/v1/sensor/metadata"
PORT: Final = 80
ANSWER_S: Final = 5.0
LIVE_ANSWER_S: Final = 2.0
"""The same while its packets come: they wait in the queue meanwhile."""
MAX_ANSWER_BYTES: Final = 2 * MAX_BYTES
"""Headers and metadata; chunks have a head each."""
READ_BYTES: Final = 16 * 1024


def metadata_over_http(host: str, port: int = PORT, answer_s: float = ANSWER_S, *, near: bool = False) -> bytes:
    """The checked metadata of an Ouster. host: its name or address

    near: connect only to a host of a network that this machine is in, not through a router
    The answer is read for at most `answer_s` seconds and 128 KiB. Redirections and proxies are not used.
    Raises CalibrationError if the sensor does not answer, or its answer is not the metadata of an Ouster.
    """
    address = f"http://{f'[{host}]' if ':' in host else host}{'' if port == PORT else f':{port}'}{PATH}"
    if not host or any(character.isspace() or character in "/?#@\\" for character in host):
        raise CalibrationError(f"{host!r:.80} is not the name or address of a sensor")
    try:
        answer = _answer(host, port, time.monotonic() + answer_s, near=near)
        status, body = _parsed(answer)
    except (OSError, ValueError, OverflowError, http.client.HTTPException) as error:  # a size beyond any integer, too
        said = getattr(error, "strerror", None) or str(error) or type(error).__name__
        reason = "".join(character for character in said if character.isprintable())[:120]
        raise CalibrationError(f"no metadata from {address}: {reason}") from None
    if status != http.client.OK:
        raise CalibrationError(f"no metadata from {address}: it answered with status {status}")
    try:
        read_metadata(body)
    except CalibrationError as error:
        raise CalibrationError(f"no metadata from {address}: {error}") from None
    return body


def with_metadata(bare: SensorModel, address: bytes | None, label: str) -> SensorModel:
    """An Ouster with the metadata that it tells; `bare` if it tells none, or that of other packets, with a warning.

    The address is only what packets claim, so nothing beyond the networks of this machine is asked.

    bare: a sensor of which only the packets are known;  address: 4 or 16 bytes;  label: of the source, for the warning
    """
    if not address:
        return bare
    try:
        metadata = metadata_over_http(str(ip_address(address)), answer_s=LIVE_ANSWER_S, near=True)
        return bare_sensors()[bare.model].calibrated(metadata, "stream", f"of {ip_address(address)}")
    except CalibrationError as error:
        logger.warning("%s: %s", label, error)
    except Exception:  # whatever a host answers, it ends no live source
        logger.exception("%s: the metadata of %s cannot be read", label, ip_address(address))
    return bare


def _answer(host: str, port: int, deadline: float, *, near: bool) -> bytes:
    """All bytes of the answer."""
    named = f"[{host.partition('%')[0]}]" if ":" in host else host
    asked = f"GET {PATH} HTTP/1.1\r\nHost: {named}\r\nAccept: application/json\r\nConnection: close\r\n\r\n"
    answer = bytearray()
    with _connected(host, port, deadline, near=near) as connection:
        connection.settimeout(_left(deadline))
        connection.sendall(asked.encode("ascii"))
        while not _is_whole(answer):
            connection.settimeout(_left(deadline))
            received = connection.recv(READ_BYTES)
            if not received:
                break
            answer += received
            if len(answer) > MAX_ANSWER_BYTES:
                raise http.client.HTTPException(f"the answer is larger than {MAX_ANSWER_BYTES:,} bytes")
    return bytes(answer)


def _connected(host: str, port: int, deadline: float, *, near: bool) -> socket.socket:
    """A connection to the first of the host's addresses that answers."""
    failed: OSError | None = None
    for family, kind, protocol, _, where in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        connection = socket.socket(family, kind, protocol)
        try:
            if near:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_DONTROUTE, 1)
            connection.settimeout(_left(deadline))
            connection.connect(where)
        except OSError as error:
            connection.close()
            failed = error
        else:
            return connection
    if near and failed is not None and failed.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH):
        raise OSError("this machine is not in its network; give the metadata with --calibration FILE")
    raise failed or OSError("its name has no address")


def _left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0:
        raise TimeoutError("timed out")
    return left


def _is_whole(answer: bytearray) -> bool:
    """Whether an answer has all bytes of its Content-Length, for servers that keep the connection open."""
    head, found, body = answer.partition(b"\r\n\r\n")
    for line in head.split(b"\r\n")[1:] if found else ():
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length" and value.strip().isdigit():
            return len(body) >= int(value.strip()[:9])
        if name.strip().lower() == b"transfer-encoding":
            return body.endswith(b"\r\n0\r\n\r\n")
    return False


class _Received:
    """A minimal socket for http.client."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def makefile(self, _mode: str) -> io.BytesIO:
        return io.BytesIO(self._data)


def _parsed(answer: bytes) -> tuple[int, bytes]:
    """Status and body."""
    response = http.client.HTTPResponse(cast(socket.socket, _Received(answer)), method="GET")
    response.begin()
    return response.status, response.read()
