"""OwnCertificate: the server's certificate for HTTPS. It uses a renewed file at once, and warns before it expires."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from ssl import SSLContext
from typing import Final

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import SettingsError
from lidarcodec.transport.certificates import Certificates, CertificateWatch, validities
from lidarcodec_server.config import ServerConfig
from lidarcodec_server.door.listening import check_tls, tls_of

logger = logging.getLogger(__name__)

LOOK_S: Final = 5.0
RENEW: Final = "renew it: the new file is used within a few seconds"


class OwnCertificate:
    """Looks at the files of a configuration in a thread of its own, between `start` and `close`."""

    def __init__(self, config: ServerConfig, use: Callable[[SSLContext | None], None]) -> None:
        """use: sets the TLS context of later connections"""
        self._config, self._use = config, use
        self._seen = self._state()
        self._watch: CertificateWatch | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="lidarcodec own certificate", daemon=True)

    def start(self) -> None:
        """Begin, if the server has a certificate."""
        if self._config.tls_certificate is not None:
            self._warn()
            self._thread.start()

    def close(self) -> None:
        """End. A second call does nothing."""
        self._stop.set()
        if self._watch is not None:
            self._watch.close()

    def _run(self) -> None:
        while not self._stop.wait(LOOK_S):
            found = self._state()
            if found != self._seen:
                self._renew()
                self._seen = found

    def _renew(self) -> None:
        try:
            check_tls(self._config)
            self._use(tls_of(self._config))
        except (SettingsError, OSError, ValueError) as error:
            logger.warning("the new certificate cannot be used; the earlier one stays in use: %s", error)
            return
        logger.warning("the certificate in %s was renewed and is now in use", self._config.tls_certificate)
        self._warn()

    def _warn(self) -> None:
        """Warn if the certificate in use expires soon."""
        path = self._config.tls_certificate
        if self._watch is not None:
            self._watch.close()
        try:
            found = [] if path is None else validities(read_file(path, "certificates"))
        except (OSError, ValueError, FileTooLargeError):
            return
        if found:  # the authorities that signed it may follow
            self._watch = CertificateWatch(Certificates({"certificate": found[0]}), str(path), renew=RENEW)
            self._watch.start()

    def _state(self) -> tuple[tuple[int, int, int] | None, ...]:
        """Identity and version of the files of the certificate and of the key; it changes when a file is replaced."""
        return tuple(map(_identity, (self._config.tls_certificate, self._config.tls_key)))


def _identity(path: Path | None) -> tuple[int, int, int] | None:
    try:
        found = None if path is None else path.stat()
    except OSError:
        return None
    return None if found is None else (found.st_ino, found.st_mtime_ns, found.st_size)
