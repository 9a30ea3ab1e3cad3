"""Zenoh's log: strangers who try again and again must not fill the disk with it, and the reason must not be lost."""

from __future__ import annotations

import re
import signal
import threading
import time

import pytest

from lidarcodec.commands.running.zenoh_log import MOST_KINDS, Sparse
from lidarcodec.errors import TransportError
from lidarcodec.transport import Endpoints, open_transport
from tests.command_line import start
from tests.transport.secured import deployment
from tests.transport.test_contract import eventually

REFUSED = "received fatal alert: UnknownCA"


def refused_publisher(tmp_path, **variables) -> list[str]:
    """Lines of a vehicle that listens, which a stranger tried to reach for five seconds."""
    port = deployment(tmp_path / "ours", routers=(), vehicles=("car-7@127.0.0.1",))
    deployment(tmp_path / "theirs", routers=(), vehicles=("car-7@127.0.0.1",), port=port)
    config = tmp_path / "ours" / "vehicle-car-7.json5"
    process = start("publish", "sim:street?sensor=vlp16&frames=100000", "--zenoh-config", config, variables=variables)
    said: list[str] = []
    reading = threading.Thread(target=lambda: said.extend(process.stderr), daemon=True)
    reading.start()
    try:
        stranger = open_transport(Endpoints.of(config=tmp_path / "theirs" / "viewer-anna.json5"))
        assert eventually(lambda: any(REFUSED in line for line in said), 60.0), said
        time.sleep(5.0)
        stranger.close()
    except TransportError as error:
        said.append(str(error))
    finally:
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
    reading.join(20)
    process.stdout.close()
    return said


@pytest.mark.timeout(240)
def test_connections_that_are_refused_are_reported_once_and_counted(tmp_path):
    pytest.importorskip("cryptography")
    lines = [line for line in refused_publisher(tmp_path) if REFUSED in line]
    assert len(lines) == 2, lines
    assert "\x1b" not in lines[0]
    assert all(line.startswith("Zenoh: ") for line in lines)
    assert int(re.match(r"Zenoh: (\d+) more of this kind", lines[1])[1]) >= 3


@pytest.mark.timeout(240)
def test_who_sets_rust_log_gets_every_line(tmp_path):
    pytest.importorskip("cryptography")
    assert len([line for line in refused_publisher(tmp_path, RUST_LOG="warn") if REFUSED in line]) >= 4


def test_kinds_are_bounded_and_nothing_is_left_out_uncounted():
    now = [0.0]
    sparse = Sparse(lambda: now[0])
    passed = [sparse.passed(f"{number} refused because of {'x' * number}") for number in range(200)]
    assert len([one for one in passed if one is not None]) == MOST_KINDS + 1
    assert sum(int(line.split()[0]) for line in sparse.rest()) == 200 - MOST_KINDS - 1
    assert sparse.passed("WARN net-2 zenoh::api::admin: Unable to find transport for link event: 5d") is None
    now[0] = 61.0
    assert sparse.passed("5 refused because of xxxxx") == "5 refused because of xxxxx"
