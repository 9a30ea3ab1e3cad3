"""A certificate for HTTPS that ends unseen shuts everybody out; a renewed one was not read before a restart."""

from __future__ import annotations

import socket
import ssl
import threading
from pathlib import Path

import pytest

pytest.importorskip("cryptography")
from cryptography import x509

from lidarcodec.commands.certs.certificates import Authority
from tests.command_line import start
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually


def renew(authority: Authority, folder: Path, days: int) -> None:
    issued = authority.issue("localhost", ("localhost", "127.0.0.1"), days)
    (folder / "c.pem").write_bytes(issued.certificate)
    (folder / "k.pem").write_bytes(issued.key)


def days_left(port: int) -> int | None:
    """Of the certificate that a server shows; None while it shows none."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with (
            socket.create_connection(("127.0.0.1", port), 5) as connection,
            context.wrap_socket(connection, server_hostname="localhost") as shaken,
        ):
            shown = x509.load_der_x509_certificate(shaken.getpeercert(binary_form=True) or b"")
    except OSError:
        return None
    return (shown.not_valid_after_utc - shown.not_valid_before_utc).days


@pytest.mark.sweep
def test_the_end_of_a_certificate_is_warned_of_and_a_renewed_one_is_used(tmp_path: Path) -> None:
    authority, port, said = Authority.open(tmp_path), free_port(), []
    renew(authority, tmp_path, 3)
    words = ("serve", "--port", port, "--database-url", f"sqlite:///{tmp_path / 's.db'}")
    server = start(*words, "--tls-certificate", tmp_path / "c.pem", "--tls-key", tmp_path / "k.pem")
    reader = threading.Thread(target=lambda: said.extend(server.stderr))
    reader.start()
    try:
        assert eventually(lambda: days_left(port) == 3, 60.0)
        assert eventually(lambda: any("ends on" in line and "c.pem" in line for line in said))
        (tmp_path / "c.pem").write_text("nothing")
        assert eventually(lambda: any("the earlier one stays in use" in line for line in said))
        assert days_left(port) == 3
        renew(authority, tmp_path, 90)
        assert eventually(lambda: days_left(port) == 90)
    finally:
        server.terminate()
        server.wait(60)
        reader.join(10)
    assert server.returncode == 0
