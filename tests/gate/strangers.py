"""Strangers at a TLS port, as a process: python -m tests.gate.strangers KIND PORT COUNT SOURCE

KIND: `idle` holds COUNT connections and opens those that are ended again; `garbage`, `abort` (a ClientHello, then gone)
and `nobody` (TLS without a certificate) try COUNT times a second; SOURCE is their own address, such as 127.0.0.2.
`127.1.0.*` takes another one of that network each time, `*` one of another network.
"""

from __future__ import annotations

import contextlib
import socket
import ssl
import sys
import threading
import time


def hello(most: ssl.TLSVersion = ssl.TLSVersion.TLSv1_3) -> bytes:
    """A ClientHello as OpenSSL writes it."""
    out = ssl.MemoryBIO()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.maximum_version = most
    client = context.wrap_bio(ssl.MemoryBIO(), out, server_hostname="localhost")
    with contextlib.suppress(ssl.SSLWantReadError):
        client.do_handshake()
    return out.read()


HELLO = hello()
NOBODY = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
NOBODY.check_hostname, NOBODY.verify_mode = False, ssl.CERT_NONE


def connected(port: int, source: str, number: int) -> socket.socket:
    """A connection from that address."""
    own = source.replace("*", str(number % 250 + 1))
    if source == "*":
        own = f"127.{number % 250 + 1}.{number // 250 % 250}.1"
    return socket.create_connection(("127.0.0.1", port), 5, source_address=(own, 0))


def once(kind: str, port: int, source: str, number: int) -> None:
    """One try."""
    with contextlib.suppress(OSError), connected(port, source, number) as one:
        if kind == "garbage":
            one.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        elif kind == "abort":
            one.sendall(HELLO)
            one.settimeout(0.2)
            one.recv(1)
        else:
            with NOBODY.wrap_socket(one) as encrypted:
                encrypted.sendall(b"hello")
                encrypted.recv(100)


def holding(port: int, count: int, source: str) -> None:
    """Hold so many connections that say nothing."""
    held: list[socket.socket] = []
    while True:
        for one in list(held):
            one.setblocking(False)
            try:
                ended = not one.recv(1)
            except BlockingIOError:
                continue
            except OSError:
                ended = True
            if ended:
                one.close()
                held.remove(one)
        for number in range(count - len(held)):
            with contextlib.suppress(OSError):
                held.append(connected(port, source, number))
        time.sleep(0.5)


def main(kind: str, port: int, count: int, source: str) -> None:
    if kind == "idle":
        holding(port, count, source)
    begun, number = time.monotonic(), 0
    while True:
        threading.Thread(target=once, args=(kind, port, source, number), daemon=True).start()
        number += 1
        time.sleep(max(0.0, begun + number / count - time.monotonic()))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
