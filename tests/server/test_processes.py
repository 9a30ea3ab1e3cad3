"""The server as it is run: vehicles and server as processes, over Zenoh, stopped, killed and started again."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa
from typer.testing import CliRunner

from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.commands import serve, token
from lidarcodec.errors import SettingsError, TransportError
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.migrations import StoreError
from tests.command_line import COMMAND, environment, start, the_one_line
from tests.server.conftest import STREAM
from tests.sweeps import sampled
from tests.transport.conftest import free_port

pytestmark = pytest.mark.timeout(180)
CAR = ("--vehicle", "car-7", "--sensor", "roof")


def until(condition, limit_s=60.0):
    """The first true value that a function gives."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(0.05)
    raise AssertionError("it never happened")


class Server:
    """A `serve` process and a client of it."""

    def __init__(self, endpoint: str | None, database: str, **variables: str) -> None:
        listen = () if endpoint is None else ("--listen", endpoint)
        self.process = start("serve", "--port", 0, "--database-url", database, *listen, variables=variables)
        found = re.match(r"Serving on (http://\S+) until", self.process.stdout.readline())
        assert found, self.process.stderr.read()
        self.client = httpx.Client(base_url=found[1], timeout=30)

    def get(self, path: str):
        try:
            answer = self.client.get(path)
        except httpx.TransportError:  # it is still starting
            return {}
        return answer.json() if answer.status_code == 200 else {}

    def patch(self, **changes):
        return self.client.patch(f"{STREAM}/settings", json=changes)

    def patched(self, **changes):
        """The answer to a change that was applied; on a busy machine that may take longer than a server waits."""
        answer = until(lambda: (one := self.patch(**changes)).status_code != 202 and one)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def alive(self):
        return self.get(STREAM).get("alive")

    def applied(self, **wanted):
        """The settings in force, if they are those."""
        found = self.get(f"{STREAM}/settings").get("applied") or {}
        return all(found.get(field) == value for field, value in wanted.items()) and found

    def end(self, number=signal.SIGTERM):
        self.client.close()
        return ended(self.process, number)


def ended(process, number=signal.SIGTERM):
    """Send a signal; the exit code and what was said on stderr."""
    if process.poll() is None:
        process.send_signal(number)
    _, complaints = process.communicate(timeout=60)
    return process.returncode, complaints


@pytest.fixture
def processes():
    """List of processes that are killed after the test."""
    found: list[subprocess.Popen] = []
    yield found
    for process in found:
        if process.poll() is None:
            ended(process, signal.SIGKILL)


@pytest.fixture
def database(tmp_path):
    """URL of a database that is not there yet."""
    return f"sqlite:///{tmp_path / 'server.db'}"


@pytest.fixture
def place(tmp_path):
    """A Zenoh endpoint and a database of this test."""
    return f"tcp/127.0.0.1:{free_port()}", f"sqlite:///{tmp_path / 'server.db'}"


def publish(processes, endpoint, source="sim:city", *words):
    processes.append(start("publish", source, *CAR, "--rate", 4, "--connect", endpoint, *words))
    return processes[-1]


class Watcher:
    """Decodes the stream in a thread; indices and the codec that was in the message of each."""

    def __init__(self, endpoint: str) -> None:
        self.live = LiveStream("car-7/roof", endpoints=Endpoints.of(connect=endpoint), newest=False, receiver="watcher")
        self.indices: list[int] = []
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        for frame in self.live:
            self.indices.append(frame.index)

    def __enter__(self):
        self.live.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *exc):
        self.live.interrupt()
        self._thread.join(10)
        self.live.__exit__(*exc)


@pytest.mark.sweep
def test_codec_and_bitrate_of_a_real_drive_change_while_it_is_watched_and_no_frame_is_lost(processes, place, data_file):
    capture = data_file("kitti_0005.pcap.xz")
    calibration = data_file("kitti_hdl64e_s2_recovered_db.xml")
    server = Server(*place)
    processes.append(server.process)
    with Watcher(place[0]) as watcher:
        car = publish(processes, place[0], capture, "--calibration", calibration)
        until(server.alive)
        until(lambda: len(watcher.indices) > 5)
        wanted = [
            {"codec": "h264", "target_kbps": 3000, "max_error_m": None},
            {"codec": "jpeg-layered", "target_kbps": 5000, "key_interval": 20},
        ]
        starts = []
        for changes in wanted:
            body = server.patched(**changes)
            assert body["applied"] == body["desired"]
            assert changes.items() <= body["applied"].items()
            assert server.applied(**changes) == body["applied"]
            with open_transport(Endpoints.of(connect=place[0])) as transport:
                asked = json.loads(transport.ask(StreamKeys("car-7", "roof").control_get, timeout_s=10))
            assert asked["settings"] == body["applied"]
            starts.append(body["first_frame"])
            until(lambda: watcher.indices[-1] > starts[-1] + 8)
        status = asked["status"]
        ended(car)
        indices = list(watcher.indices)
    assert indices == sorted(set(indices))
    missing = set(range(indices[0], starts[-1] + 8)) - set(indices)
    assert len(missing) <= status["replaced"] + 2, "frames are missing that were not replaced"
    assert watcher.live.summary()["errors"] == {}
    entries = [one for one in server.get(f"{STREAM}/audit")[::-1] if one["result"] == "applied"]
    assert [one["new"]["codec"] for one in entries if one["first_frame"] in starts] == ["h264", "jpeg-layered"]
    assert {one["who"] for one in entries} <= {"127.0.0.1", "server"}
    assert server.end() == (0, "")


def test_what_operators_set_comes_back_after_a_kill_of_either_side(processes, place):
    server = Server(*place)
    processes.append(server.process)
    car = publish(processes, place[0])
    until(server.alive)
    server.patched(codec="zstd", key_interval=9)
    ended(car, signal.SIGKILL)
    until(lambda: not server.alive())
    assert server.patch(key_interval=11).status_code == 202
    publish(processes, place[0], "sim:city", "--codec", "raw")
    until(lambda: server.applied(codec="zstd", key_interval=11))
    until(lambda: server.get(f"{STREAM}/audit")[0]["result"] == "applied")  # it is written after that
    server.end(signal.SIGKILL)
    again = Server(*place)
    processes.append(again.process)
    until(again.alive)
    told = until(lambda: (one := again.get(f"{STREAM}/settings")).get("applied") and one)
    assert told["applied"] == told["desired"]
    assert told["operator"] == {"codec": "zstd", "key_interval": 11}
    results = [(entry["who"], entry["result"]) for entry in again.get(f"{STREAM}/audit")]
    assert results[:2] == [("server", "applied"), ("127.0.0.1", "stored")]
    with socket.create_connection((again.client.base_url.host, again.client.base_url.port)) as idle:
        idle.sendall(b"PATCH /api/v1/streams/a/b/settings HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n")
        assert again.end(signal.SIGINT)[0] == 0  # within `communicate`'s limit, whoever is connected


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"host": "0.0.0.0"}, "lidarcodec token create"),
        ({"database_url": "nonsense"}, "database URL"),
        ({"tls_certificate": Path("a.pem")}, "both --tls-certificate and --tls-key"),
        ({"tls_certificate": Path("a.pem"), "tls_key": Path("a.key")}, "cannot read a.pem: No such file"),
        ({"tls_certificate": Path(__file__), "tls_key": Path(__file__)}, "must be a PEM certificate and its key"),
        ({"max_streams": 20_000}, "max_streams"),
    ],
)
def test_what_cannot_be_served_is_wrong_usage_and_said(database, values, said):
    with pytest.raises(SettingsError, match=said):
        serve.run(([], [], None), **({"port": 0, "database_url": database} | values))


def test_a_port_that_is_taken_is_reported(database):
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        pytest.raises(TransportError, match="cannot listen on"),
    ):
        serve.run(([], [], None), port=taken.getsockname()[1], database_url=database)


def test_a_database_of_a_newer_version_ends_the_start_with_the_reason(database, capsys):
    assert token_command("create", "ada", database).exit_code == 0
    engine = sa.create_engine(database)
    with engine.begin() as connection:
        connection.execute(sa.text("UPDATE alembic_version SET version_num = 'later'"))
    engine.dispose()
    with pytest.raises(StoreError, match=r"newer.*--database-url") as refused:
        serve.run(([], [], None), port=0, database_url=database)
    assert engine.url.render_as_string() in str(refused.value)  # without its password
    assert "Serving" not in capsys.readouterr().out  # who reads that line relies on a server


@pytest.mark.parametrize("reader", sampled(["that reads nothing", "full disk"], ["full disk"]))
def test_a_token_that_cannot_be_printed_is_worth_nothing(database, reader):
    if reader == "full disk":
        to = os.open("/dev/full", os.O_WRONLY)
    else:
        other, to = os.pipe()
        os.close(other)
    words = [*COMMAND, "token", "create", "ada", "--database-url", database]
    with os.fdopen(to, "w") as output:
        done = subprocess.run(words, stdout=output, stderr=subprocess.PIPE, text=True, env=environment(), check=False)
    assert done.returncode == 1
    assert "so it was revoked" in the_one_line(done)
    assert "revoked 2" in token_command("list", database).stdout


def token_command(*words):
    """`lidarcodec token ...`; the last word is the database."""
    return CliRunner().invoke(token.app, [*words[:-1], "--database-url", words[-1]])


def test_tokens_are_made_listed_and_revoked_on_the_command_line(database):
    made = token_command("create", "ada", "--role", "operator", database)
    assert re.fullmatch(r"lct_[A-Za-z0-9_-]{43}\n", made.stdout)
    (listed,) = json.loads(token_command("list", "--json", database).stdout)
    assert (listed["name"], listed["role"], listed["revoked"]) == ("ada", "operator", None)
    assert token_command("revoke", "ada", database).exit_code == 0
    assert "revoked 2" in token_command("list", database).stdout
    for words in (("revoke", "ada"), ("create", "ada"), ("create", "otto", "--role", "king")):
        assert isinstance(token_command(*words, database).exception, SettingsError)


@pytest.mark.parametrize("words", [("list",), ("revoke", "ada")])
def test_looking_for_tokens_where_no_database_is_says_so_and_makes_none(tmp_path, words):
    """A list that is empty because of a typing error looks like one of a server without tokens."""
    file = tmp_path / "folder" / "server.db"
    answer = token_command(*words, f"sqlite:///{file}")
    assert isinstance(answer.exception, StoreError)
    assert f"no database {file}" in str(answer.exception)
    assert not file.parent.exists()


@pytest.mark.parametrize("command", [["serve"], ["token", "list"]])
def test_without_the_extra_the_command_says_how_to_get_it(command):
    code = (
        "import sys; sys.modules['fastapi'] = sys.modules['sqlalchemy'] = None\n"
        f"from lidarcodec.cli import run; sys.exit(run({command!r}))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment(), timeout=60, check=False
    )
    assert result.returncode == 2
    assert "pip install 'lidarcodec[server]'" in the_one_line(result)
