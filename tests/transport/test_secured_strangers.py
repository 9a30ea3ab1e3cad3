"""Strangers and people who were removed do not get into a secured deployment, and the router says why."""

from __future__ import annotations

import json
import shutil
import threading
import time
from pathlib import Path

import pytest

from lidarcodec.commands.certs import command as certs
from lidarcodec.errors import TransportError
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Priority
from tests.transport.router import Router
from tests.transport.secured import CAR, QUIET_S, Secured, deployment
from tests.transport.test_contract import comes, eventually

pytest.importorskip("cryptography")
pytestmark = pytest.mark.timeout(120)


def refused(path: Path, change=lambda tls, auth: None) -> None:
    """Nobody gets in with this configuration, changed in its TLS and user settings; it is tried until it is stopped."""
    config = json.loads(path.read_text().partition("\n")[2])
    change(config["transport"]["link"]["tls"], config["transport"].get("auth", {}).get("usrpwd", {}))
    changed = path.with_name("changed.json5")
    changed.write_text(json.dumps(config))
    stop = threading.Event()
    threading.Timer(0.8, stop.set).start()
    with pytest.raises(TransportError, match="stopped"):
        open_transport(Endpoints.of(config=changed), stop=stop).close()
    changed.unlink()


def foreign(folder: Path, made: Secured) -> Path:
    """Anna's file of another deployment, whose authority nobody here knows."""
    other = folder / "other"
    other.mkdir()
    deployment(other, made.auth, port=made.port)
    return other / "viewer-anna.json5"


def foreign_but_trusting(folder: Path, made: Secured) -> None:
    """Who trusts this deployment, with a certificate of another."""
    own = json.loads(anna(made).read_text().partition("\n")[2])["transport"]["link"]["tls"]
    key = "root_ca_certificate_base64"
    refused(foreign(folder, made), lambda tls, auth: tls.update({key: own[key]}))


def without_certificate(tls: dict, auth: dict) -> None:
    del tls["connect_certificate_base64"], tls["connect_private_key_base64"]
    tls["enable_mtls"] = False


def anna(made: Secured) -> Path:
    return made.folder / "viewer-anna.json5"


STRANGERS = [
    ("certificate", "UnknownCA", lambda folder, made: refused(foreign(folder, made))),
    ("certificate", "UnknownIssuer", foreign_but_trusting),
    ("certificate", "peer sent no certificates", lambda folder, made: refused(anna(made), without_certificate)),
    ("password", "UnknownCA", lambda folder, made: refused(foreign(folder, made))),
    ("password", "Invalid password", lambda _, made: refused(anna(made), lambda _, auth: auth.update(password="x"))),
    ("password", "Invalid user", lambda _, made: refused(anna(made), lambda _, auth: auth.update(user="nobody"))),
    ("password", "UsrPwd", lambda _, made: refused(anna(made), lambda _, auth: auth.clear())),
]


@pytest.mark.parametrize(("auth", "reason", "tried"), STRANGERS)
def test_strangers_do_not_get_in_and_the_router_says_why(tmp_path, caplog, auth, reason, tried):
    """Each with a router of its own, because an address that fails a few times is barred."""
    (tmp_path / "own").mkdir()
    made = Secured(tmp_path / "own", auth)
    try:
        tried(tmp_path, made)
        assert eventually(lambda: reason in made.router.log), made.router.log
        assert "again until it works" in caplog.text
    finally:
        made.close()


def test_who_was_removed_may_do_nothing_any_more(tmp_path):
    made = Secured(tmp_path, "certificate")
    try:
        kept = tmp_path / "kept.json5"
        shutil.copy(tmp_path / "viewer-anna.json5", kept)
        certs.run(tmp_path, remove=["anna"], days=30)
        assert not (tmp_path / "viewer-anna.json5").exists()
        made.router.kill()
        made.router = Router(config=str(tmp_path / "router-localhost.json5"), listen=made.endpoint)
        made.opened.append(anna := open_transport(Endpoints.of(config=kept)))
        car, ben = made.open("vehicle-car-7"), made.open("viewer-ben")
        removed, heard = [], []
        anna.listen(CAR.frame, lambda key, data: removed.append(data))
        ben.listen(CAR.frame, lambda key, data: heard.append(data))
        sender = car.sender(CAR.frame, Priority.FRAMES)
        assert eventually(lambda: sender.matching)
        assert comes(sender, b"frame", lambda: heard)
        time.sleep(QUIET_S)
        assert not removed
    finally:
        made.close()
