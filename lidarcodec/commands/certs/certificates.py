"""A private certificate authority, and certificates from it. Needs the package `cryptography` (extra `server`).

Keys are on the curve P-256. Certificates of parties that listen are valid for both ends of a connection, because
routers also connect. Access control uses the common name; clients check the subject alternative names.
"""

from __future__ import annotations

import ipaddress
import os
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from lidarcodec.budgets import read_file
from lidarcodec.errors import MissingExtraError, SettingsError
from lidarcodec.files.whole import written_whole

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

CA_DAYS = 3650
EARLIER = timedelta(hours=1)
"""Certificates are valid from an hour ago on, for machines whose clock is slow."""


def write_private(path: Path, data: bytes) -> None:
    """Write a secret to a new file that only its owner can read at any time."""
    with written_whole(path, private=True) as beside:
        beside.write_bytes(data)


@dataclass(frozen=True)
class Issued:
    """A certificate and its key, in PEM, and the end of its validity."""

    certificate: bytes
    key: bytes
    until: datetime


class Authority:
    """Signs certificates. Its own certificate and key are in a folder as `ca.pem` and `ca.key`."""

    def __init__(self, certificate: x509.Certificate, key: EllipticCurvePrivateKey) -> None:
        self._certificate, self._key = certificate, key

    @classmethod
    def open(cls, folder: Path) -> Self:
        """The authority in a folder; a new one if there is none.

        Raises SettingsError when its files are invalid or expired, MissingExtraError without `cryptography`.
        """
        x509, ec, serialization = _cryptography()
        pem, key_file = folder / "ca.pem", folder / "ca.key"
        if not pem.exists() and not key_file.exists():
            made = cls._made()
            write_private(key_file, _key_pem(made._key))
            with written_whole(pem) as beside:
                beside.write_bytes(made.pem)
            return made
        try:
            certificate = x509.load_pem_x509_certificate(read_file(pem, "certificates"))
            key = serialization.load_pem_private_key(read_file(key_file, "certificates"), None)
        except (OSError, ValueError) as error:
            raise SettingsError(f"the certificate authority in {folder} cannot be used: {error}") from None
        if not isinstance(key, ec.EllipticCurvePrivateKey) or certificate.public_key() != key.public_key():
            raise SettingsError(f"{key_file} is not the key of {pem}")
        if certificate.not_valid_after_utc < datetime.now(UTC):
            raise SettingsError(f"{pem} has expired: start with an empty folder, and give every machine its new file")
        return cls(certificate, key)

    @property
    def pem(self) -> bytes:
        """The authority's certificate in PEM, which every party needs to check certificates."""
        _, _, serialization = _cryptography()
        return bytes(self._certificate.public_bytes(serialization.Encoding.PEM))

    def issue(self, name: str, hosts: tuple[str, ...], days: int) -> Issued:
        """A new key and certificate. hosts: names and addresses under which it listens. Without hosts it is valid only
        for clients, so that a vehicle or viewer cannot pretend to be a router of the same name."""
        x509, ec, _ = _cryptography()
        from cryptography.x509.oid import ExtendedKeyUsageOID

        key = ec.generate_private_key(ec.SECP256R1())
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if hosts else [])]
        until = min(datetime.now(UTC) + timedelta(days=days), self._certificate.not_valid_after_utc)
        built = (
            _builder(name, key.public_key(), until)
            .issuer_name(self._certificate.subject)
            .add_extension(x509.SubjectAlternativeName([_alternative(host) for host in hosts or (name,)]), False)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
            .add_extension(_usage(signs_certificates=False), True)
            .add_extension(x509.ExtendedKeyUsage(uses), False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), False)
        )
        return Issued(_signed(built, self._key), _key_pem(key), until)

    @classmethod
    def _made(cls) -> Self:
        x509, ec, _ = _cryptography()
        from cryptography.hazmat.primitives import hashes

        key = ec.generate_private_key(ec.SECP256R1())
        name = f"lidarcodec authority {os.urandom(4).hex()}"
        built = (
            _builder(name, key.public_key(), datetime.now(UTC) + timedelta(days=CA_DAYS))
            .issuer_name(_name(name))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), True)
            .add_extension(_usage(signs_certificates=True), True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False)
        )
        return cls(built.sign(key, hashes.SHA256()), key)


def _cryptography() -> Any:
    """The modules x509, ec and serialization.

    Raises MissingExtraError.
    """
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric import ec
    except ImportError:
        raise MissingExtraError("making certificates", "server") from None
    return x509, ec, serialization


def _name(text: str) -> Any:
    x509, _, _ = _cryptography()
    return x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, text)])


def _builder(name: str, public_key: Any, until: datetime) -> Any:
    x509, _, _ = _cryptography()
    return (
        x509.CertificateBuilder()
        .subject_name(_name(name))
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.now(UTC) - EARLIER)
        .not_valid_after(until)
    )


def _usage(*, signs_certificates: bool) -> Any:
    x509, _, _ = _cryptography()
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _alternative(host: str) -> Any:
    x509, _, _ = _cryptography()
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _key_pem(key: Any) -> bytes:
    _, _, serialization = _cryptography()
    return bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )


def _signed(builder: Any, key: Any) -> bytes:
    _, _, serialization = _cryptography()
    from cryptography.hazmat.primitives import hashes

    return bytes(builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
