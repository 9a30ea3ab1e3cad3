"""Expiry of the certificates of a Zenoh configuration. A party that refuses one reports that only in its own log.

Only the validity is read, from the DER of X.509 (RFC 5280, 4.1), without `cryptography`, which a vehicle may lack. This
module does not decide which certificates are trusted.
"""

from __future__ import annotations

import base64
import logging
import re
import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, NamedTuple

from lidarcodec.budgets import FileTooLargeError, read_file

logger = logging.getLogger(__name__)

SOON: Final = timedelta(days=30)
LOOK_S: Final = 60.0
"""Interval of checks; the clock may be set in between."""
AGAIN: Final = timedelta(days=1)
"""Time after which a warning is repeated."""
RENEW: Final = "renew it with `lidarcodec certs`"
TLS: Final = "transport/link/tls"
OWN: Final = ("connect_certificate", "listen_certificate")
AUTHORITY: Final = "root_ca_certificate"
_PEM: Final = re.compile(rb"-----BEGIN CERTIFICATE-----([A-Za-z0-9+/=\s]+)-----END CERTIFICATE-----")
_SEQUENCE, _VERSION, _INTEGER, _UTC_TIME, _TIME = 0x30, 0xA0, 0x02, 0x17, 0x18


class Validity(NamedTuple):
    """Begin and end of a certificate's validity."""

    begins: datetime
    ends: datetime


class State(NamedTuple):
    """State of certificates: `valid`, `ends soon` (within 30 days), `ended`, or `not yet valid`; and the end."""

    name: str
    until: datetime


class Certificates:
    """Certificates by kind, such as `certificate` and `certificate authority`. At least one."""

    def __init__(self, found: dict[str, Validity]) -> None:
        self._found = found

    def state(self, now: datetime | None = None) -> State:
        """State of the certificate that ends first."""
        now = datetime.now(UTC) if now is None else now
        first = min(self._found.values(), key=lambda one: one.ends)
        if first.ends <= now:
            return State("ended", first.ends)
        if any(now < one.begins for one in self._found.values()):
            return State("not yet valid", first.ends)
        return State("ends soon" if first.ends - now < SOON else "valid", first.ends)

    def told(self) -> dict[str, str]:
        """The same for a status: `state`, and `until` in ISO 8601."""
        state = self.state()
        return {"state": state.name, "until": state.until.isoformat()}

    def complaint(self, source: str, now: datetime, renew: str = RENEW) -> str | None:
        """A warning about the certificates of a file; None if they are valid for long enough. renew: what to do"""
        state = self.state(now)
        what = min(self._found, key=lambda one: self._found[one].ends)
        when, here = f"{state.until:%Y-%m-%d %H:%M} UTC", f"the clock of this machine says {now:%Y-%m-%d %H:%M} UTC"
        if state.name == "ended":
            return f"the {what} in {source} ended on {when}: others refuse its connections; {renew}"
        if state.name == "not yet valid":
            return f"the certificates in {source} are not valid yet: {here}; set it, until then connections are refused"
        if state.name == "ends soon":
            return f"the {what} in {source} ends on {when}, in {(state.until - now).days} days; {renew}"
        return None


class CertificateWatch:
    """Logs the state of a session's certificates: at `start`, at changes, and once a day while there is a problem."""

    def __init__(
        self,
        certificates: Certificates | None,
        source: str,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        renew: str = RENEW,
    ) -> None:
        """source: the file that they are in;  renew: what to do when they end"""
        self._certificates, self._source, self._now, self._renew = certificates, source, now, renew
        self._stop = threading.Event()
        self._said: tuple[str, datetime] | None = None
        self._thread = threading.Thread(target=self._run, name="lidarcodec certificates", daemon=True)

    def start(self) -> None:
        """Start watching, if there are certificates."""
        if self._certificates is not None:
            self._look(self._certificates)
            self._thread.start()

    def close(self) -> None:
        """End; harmless when called twice."""
        self._stop.set()

    def _look(self, certificates: Certificates) -> float:
        """Log a warning if needed; returns the seconds until the next check."""
        now = self._now()
        state = certificates.state(now)
        due = self._said is None or self._said[0] != state.name or not timedelta() <= now - self._said[1] < AGAIN
        if due:
            self._said = state.name, now
            complaint = certificates.complaint(self._source, now, self._renew)
            if complaint is not None:
                logger.warning("%s", complaint)
        left_s = (state.until - now).total_seconds()
        return min(LOOK_S, left_s + 0.1) if left_s > 0.0 else LOOK_S

    def _run(self) -> None:
        wait_s = 0.0
        while self._certificates is not None and not self._stop.wait(wait_s):
            wait_s = self._look(self._certificates)


def certificates_in(option: Callable[[str], Any]) -> Certificates | None:
    """The certificates of a configuration; None if none can be read, which the session will report.

    option: gives the value at a path of the configuration
    """
    found: dict[str, Validity] = {}
    own = [one for name in OWN for one in _validities(option, name)[:1]]  # the authorities that signed it may follow
    if own:
        found["certificate"] = min(own, key=lambda one: one.ends)
    authorities = _validities(option, AUTHORITY)
    if authorities:
        found["certificate of the authority"] = max(authorities, key=lambda one: one.ends)  # one will do
    return Certificates(found) if found else None


def _validities(option: Callable[[str], Any], name: str) -> list[Validity]:
    """Of the certificates that stand in a configuration or in a file that it names."""
    inside, path = option(f"{TLS}/{name}_base64"), option(f"{TLS}/{name}")
    try:
        if isinstance(inside, str):
            return validities(base64.b64decode(inside))
        return validities(read_file(Path(path), "certificates")) if isinstance(path, str) else []
    except (OSError, ValueError, FileTooLargeError):
        return []


def validities(pem: bytes) -> list[Validity]:
    """Of each certificate in a PEM file, in order.

    Raises ValueError for what is no certificate.
    """
    return [_validity(base64.b64decode(one, validate=False)) for one in _PEM.findall(pem)]


def _validity(der: bytes) -> Validity:
    """RFC 5280, 4.1: Certificate, in it TBSCertificate, in it version, serialNumber, signature, issuer, validity."""
    at, _ = _element(der, 0, _SEQUENCE)
    at, _ = _element(der, at, _SEQUENCE)
    if der[at : at + 1] == bytes([_VERSION]):
        at = _element(der, at, _VERSION)[1]
    for tag in (_INTEGER, _SEQUENCE, _SEQUENCE):
        at = _element(der, at, tag)[1]
    at, _ = _element(der, at, _SEQUENCE)
    begins, at = _time(der, at)
    return Validity(begins, _time(der, at)[0])


def _time(der: bytes, at: int) -> tuple[datetime, int]:
    """A time and where it ends; UTCTime has two digits of the year, from 1950 on (4.1.2.5)."""
    tag = _UTC_TIME if der[at : at + 1] == bytes([_UTC_TIME]) else _TIME
    begin, end = _element(der, at, tag)
    text = der[begin:end].decode("ascii")
    if tag == _UTC_TIME:
        text = ("20" if text[:2] < "50" else "19") + text
    return datetime.strptime(text, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC), end


def _element(der: bytes, at: int, tag: int) -> tuple[int, int]:
    """Where the contents of an element with that tag begin and end.

    Raises ValueError where there is none.
    """
    head = der[at : at + 2]
    if len(head) < 2 or head[0] != tag:
        raise ValueError("no certificate")
    begin, size = at + 2, head[1]
    if size & 0x80:
        begin += size & 0x7F
        size = int.from_bytes(der[at + 2 : begin], "big") if begin - at <= 6 else len(der)
    if begin + size > len(der):
        raise ValueError("a certificate that is cut off")
    return begin, begin + size


__all__ = ["CertificateWatch", "Certificates", "certificates_in"]
