"""The server's listening socket. It is opened first, while the rest of the server is loaded, which takes a second.

A client that connects meanwhile waits in the system's queue. Nothing heavy is imported here.
"""

from __future__ import annotations

import errno
import socket
import ssl
import sys
from importlib.util import find_spec

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import SettingsError, TransportError
from lidarcodec_server.config import ServerConfig

for needed in ("fastapi", "sqlalchemy", "uvicorn"):
    if find_spec(needed) is None:  # report it before an address is printed
        raise ModuleNotFoundError(f"No module named '{needed}'", name=needed)


def begin(config: ServerConfig) -> socket.socket:
    """Listen.

    Raises SettingsError for unusable TLS files, TransportError if it cannot listen on the address.
    """
    check_tls(config)
    return listen(config.host, config.port)


def address_of(listener: socket.socket, config: ServerConfig) -> str:
    """The URL for a browser, for example http://127.0.0.1:8080."""
    host, port = listener.getsockname()[:2]
    scheme = "http" if config.tls_certificate is None else "https"
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"


def check_tls(config: ServerConfig) -> None:
    """Try the certificate and the key before anything is opened.

    Raises SettingsError if one of them is missing or invalid.
    """
    if (config.tls_certificate is None) != (config.tls_key is None):
        raise SettingsError("TLS needs both --tls-certificate and --tls-key", "tls_key")
    if config.tls_certificate is None or config.tls_key is None:
        return
    for path, name in ((config.tls_certificate, "tls_certificate"), (config.tls_key, "tls_key")):
        try:
            read_file(path, "certificates")
        except OSError as error:
            raise SettingsError(f"cannot read {path}: {error.strerror or error}", name) from None
        except FileTooLargeError as error:
            raise SettingsError(f"cannot read {path}: {error}", name) from None
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(config.tls_certificate, config.tls_key, password="")
    except (ssl.SSLError, ValueError):
        raise SettingsError(
            f"{config.tls_certificate} and {config.tls_key} must be a PEM certificate and its key without a password",
            "tls_certificate",
        ) from None


def tls_of(config: ServerConfig) -> ssl.SSLContext | None:
    """The TLS context; None for plain HTTP. `check_tls` must have checked the files."""
    if config.tls_certificate is None:
        return None
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    made.load_cert_chain(config.tls_certificate, config.tls_key, password="")
    return made


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens.

    Raises TransportError.
    """
    try:
        family, kind, number, _, address = socket.getaddrinfo(
            host.strip("[]"), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, number)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(address)
            listener.listen(socket.SOMAXCONN)
        except OSError:
            listener.close()
            raise
    except OSError as error:
        why = error.strerror
        if error.errno == errno.EADDRINUSE:
            why = "another program uses it: end that one, or choose another with --port"
        raise TransportError(f"cannot listen on {host} port {port}: {why}") from None
    listener.set_inheritable(sys.platform == "win32")
    return listener
