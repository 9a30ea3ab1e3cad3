"""TLS as seen from outside (RFC 8446): the ClientHello, and how far a handshake is by the records that pass.

In TLS 1.3 everything after ServerHello is encrypted and looks alike (type 23), the client's certificate included. What
can be seen is the order: the client proves itself, and a server that believes it answers with more than an alert.
"""

from __future__ import annotations

from typing import Final

MAX_HELLO: Final = 16384
MAX_RECORD: Final = 16384 + 256
"""Bytes of a record of TLS 1.3 (5.2)."""
ALERT_BYTES: Final = 19
"""An encrypted alert: 2 bytes, a type, and a tag of 16. Whatever is this short is not counted as an answer."""
_HANDSHAKE, _DATA, _CLIENT_HELLO = 22, 23, 1
_SUPPORTED_VERSIONS, _EARLY_DATA, _TLS_1_3 = 43, 42, 0x0304


class NotTlsError(ValueError):
    """Bytes that no TLS 1.3 client sends, or that Zenoh's listener would refuse."""


def whole_hello(data: bytes | bytearray) -> bool:
    """Whether data begins with a whole ClientHello; False while more has to come.

    Raises NotTlsError for one that is not well-formed, offers no TLS 1.3, or announces early data: that a server
    skips without a word, so an answer would prove nothing.
    """
    at, message = 0, b""
    while True:
        head = data[at : at + 5]
        if (head and head[0] != _HANDSHAKE) or (len(head) > 1 and head[1] != 3):
            raise NotTlsError("no handshake record")
        if len(head) < 5:
            return False
        size = int.from_bytes(head[3:5], "big")
        if not 0 < size <= MAX_HELLO:
            raise NotTlsError("a record of a wrong size")
        part = data[at + 5 : at + 5 + size]
        message += bytes(part)
        if message[:1] not in (b"", b"\x01"):
            raise NotTlsError("no ClientHello")
        whole = 4 + int.from_bytes(message[1:4], "big") if len(message) >= 4 else 0
        if whole > MAX_HELLO or len(message) > MAX_HELLO:
            raise NotTlsError("a ClientHello that is too long")
        if whole and len(message) >= whole:
            if len(message) > whole or len(data) > at + 5 + size:
                raise NotTlsError("more than a ClientHello")
            _check_hello(message[4:])
            return True
        if len(part) < size:
            return False
        at += 5 + size


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, size: int) -> bytes:
        part = self._data[self._at : self._at + size]
        if len(part) < size:
            raise NotTlsError("a ClientHello that is cut off")
        self._at += size
        return part

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "big")

    def list(self, size: int) -> bytes:
        """A list whose length in bytes stands before it, in `size` bytes."""
        return self.take(self.number(size))

    @property
    def left(self) -> int:
        return len(self._data) - self._at


def _check_hello(body: bytes) -> None:
    """RFC 8446, 4.1.2."""
    read = _Reader(body)
    if read.number(2) != 0x0303:
        raise NotTlsError("a wrong version")
    read.take(32)
    session, ciphers, compression = read.list(1), read.list(2), read.list(1)
    if len(session) > 32 or not ciphers or len(ciphers) % 2 or compression != b"\0":
        raise NotTlsError("a wrong ClientHello")
    extensions = _Reader(read.list(2))
    if read.left:
        raise NotTlsError("more than a ClientHello")
    versions, seen = b"", set()
    while extensions.left:
        kind = extensions.number(2)
        value = extensions.list(2)
        if kind == _EARLY_DATA or kind in seen:
            raise NotTlsError("a wrong extension")
        seen.add(kind)
        if kind == _SUPPORTED_VERSIONS:
            versions = _Reader(value).list(1)
    if _TLS_1_3.to_bytes(2, "big") not in (versions[at : at + 2] for at in range(0, len(versions), 2)):
        raise NotTlsError("no TLS 1.3")


class Direction:
    """Counts whole records of one direction, without keeping them."""

    def __init__(self) -> None:
        self._head, self._left, self._counts = b"", 0, False

    def passed(self, data: bytes | memoryview, least: int = 0) -> int:
        """Number of records of type 23, longer than `least`, that end in this data.

        Raises NotTlsError for what is no record.
        """
        at, found = 0, 0
        while at < len(data):
            if self._left == 0:
                part = bytes(data[at : at + 5 - len(self._head)])
                self._head += part
                at += len(part)
                if len(self._head) < 5:
                    break
                kind, size = self._head[0], int.from_bytes(self._head[3:5], "big")
                if not 20 <= kind <= 24 or self._head[1] != 3 or not 0 < size <= MAX_RECORD:
                    raise NotTlsError("no record")
                self._head, self._left, self._counts = b"", size, kind == _DATA and size > least
            part_size = min(self._left, len(data) - at)
            self._left -= part_size
            at += part_size
            found += self._left == 0 and self._counts
        return found


class Progress:
    """How far a handshake is. turns: answers of the server after the client has proved itself, each to something new.

    Zenoh accepts a session with InitAck and OpenAck, and TLS may send tickets before. Anybody who has passed TLS gets
    tickets and InitAck, so a session is sure from the third turn on. Should they come together, the third turn is
    Zenoh's keep-alive, 2.5 s later.
    """

    SESSION: Final = 3

    def __init__(self) -> None:
        self._client, self._server = Direction(), Direction()
        self._begun, self._client_spoke = False, False
        self.turns = 0

    def from_client(self, data: bytes | memoryview) -> None:
        """Data from the client passed. Raises NotTlsError."""
        if self._client.passed(data) and self._begun:
            self._client_spoke = True

    def from_server(self, data: bytes | memoryview) -> None:
        """Data from the server passed. Raises NotTlsError."""
        if not self._server.passed(data, ALERT_BYTES):
            return
        if self._client_spoke:
            self._client_spoke = False
            self.turns += 1
        self._begun = True
