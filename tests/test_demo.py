"""The demonstration as a user runs it: its page shows the vehicle, and nothing is left when it ends."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import socket
import subprocess
from pathlib import Path

import httpx
import pytest

from lidarcodec.apps.demo import processes
from lidarcodec.apps.demo.browser import SCREENS, browser, show
from lidarcodec.errors import TransportError
from tests import asking, forks
from tests.command_line import COMMAND, environment, run, the_one_line
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

LIMIT_S = 120.0
"""Longest wait for anything: three processes start, which takes 2 s at rest and has taken 50."""
pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def demo(tmp_path):
    """Function that starts a demonstration in a folder of its own; gives the process, and where its page is."""
    started = []

    def start(*words: str, stdout=subprocess.PIPE, **variables: str):
        process = forks.Process(
            [*COMMAND, "demo", *words],
            cwd=tmp_path,
            env=environment(TMPDIR=str(tmp_path), **variables),
            stdout=stdout,
            stderr=subprocess.PIPE,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        process.communicate(timeout=LIMIT_S)


def script(path: Path, line: str) -> str:
    """A program that does one thing."""
    path.write_text(f"#!/bin/sh\n{line}\n")
    path.chmod(0o755)
    return str(path)


def address_in(text: str) -> str:
    return re.search(r"The page is at (http://127\.0\.0\.1:\d+)", text)[1]


def alive(url: str) -> bool:
    try:
        return [row["vehicle"] for row in asking.get(f"{url}/api/v1/fleet", timeout=60).json() if row["alive"]] == [
            "demo"
        ]
    except httpx.HTTPError:
        return False


def gone(url: str) -> bool:
    try:
        asking.get(f"{url}/healthz", timeout=60)
    except httpx.ConnectError:
        return True
    return False


def test_the_page_shows_the_vehicle_and_changes_it_and_goes_with_the_demonstration(demo, tmp_path):
    program = script(tmp_path / "browser", f"touch {tmp_path}/opened")
    process = demo("--no-browser", "--seconds", "60", BROWSER=program)
    url = address_in(process.stdout.readline().decode())
    assert eventually(lambda: alive(url), LIMIT_S)
    assert asking.get(url, timeout=30).headers["content-type"].startswith("text/html")
    settings = f"{url}/api/v1/streams/demo/lidar/settings"
    assert asking.patch(settings, json={"codec": "zstd"}, timeout=30).json()["applied"]["codec"] == "zstd"
    process.send_signal(signal.SIGTERM)
    said, complaints = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, complaints) == (0, b"")
    assert b"frames" in said
    assert gone(url)
    assert list(tmp_path.glob("lidarcodec-demo-*")) == []
    assert not (tmp_path / "opened").exists()


@pytest.mark.sweep
def test_a_short_capture_of_another_sensor_is_played_for_the_asked_time_and_counted_as_it_is(demo, data_file):
    """Else 0.4 s of data gave rates of a single burst, and its packets were counted as longer ones."""
    capture = data_file("sensors/hesai/pandar_xt32m.pcap.xz")
    process = demo("--no-browser", "--seconds", "6", "--json", "--source", str(capture))
    said, complaints = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, complaints
    figures = json.loads(said)
    assert figures["seconds"] > 5.0
    assert figures["fps"] < 15.0
    assert figures["raw_kbps"] == pytest.approx(figures["fps"] * 8 * 487 * 820 / 1000, rel=0.1)


@pytest.mark.parametrize("source", ["drive.pcap", "drive.mcap?read=lidarcodec", "sim:city"])
def test_what_has_an_end_begins_again_and_what_is_live_does_not(source):
    assert processes.repeats(source) == ["--loop"]
    assert processes.repeats("udp://:2368") == processes.repeats("ros2:/points") == []


@pytest.mark.sweep
def test_a_browser_is_opened_where_there_is_one(demo, tmp_path):
    program = script(tmp_path / "browser", f'echo "$1" > {tmp_path}/new; mv {tmp_path}/new {tmp_path}/opened')
    process = demo("--seconds", "2", BROWSER=f"{program} %s")
    said = process.communicate(timeout=LIMIT_S)[0].decode()
    assert "opens in the browser" in said
    assert eventually((tmp_path / "opened").is_file, LIMIT_S)
    assert (tmp_path / "opened").read_text().strip() == address_in(said)


def test_no_browser_is_looked_for_where_nobody_would_see_it(monkeypatch):
    for name in ("BROWSER", *SCREENS):
        monkeypatch.delenv(name, raising=False)
    assert browser() is None
    assert not show("http://127.0.0.1:8080")


def test_a_port_that_is_asked_for_and_taken_is_refused_in_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        result = run("demo", "--seconds", "1", "--port", str(taken.getsockname()[1]))
    assert result.returncode == 1
    assert "cannot listen" in the_one_line(result)


@pytest.mark.sweep
def test_on_a_terminal_it_goes_on_until_it_is_interrupted(demo):
    screen, theirs = pty.openpty()
    process = demo("--no-browser", stdout=theirs)
    os.close(theirs)
    said = b""
    with os.fdopen(screen, "rb", buffering=0) as terminal:
        while b"Press Ctrl-C" not in said:
            said += terminal.read(4096)
        url = address_in(said.decode(errors="replace"))
        assert eventually(lambda: alive(url), LIMIT_S)
        process.send_signal(signal.SIGINT)
        try:
            while chunk := terminal.read(4096):
                said += chunk
        except OSError:  # how a terminal ends
            pass
    assert process.wait(LIMIT_S) == 0
    assert b"bits per point" in said
    assert gone(url)


def test_a_server_that_starts_late_does_not_stay_behind(monkeypatch):
    monkeypatch.setattr(processes, "START_S", 0.01)
    with processes.PageServer(None, free_port()) as server:
        late = server._process

        def never() -> bool:
            """Whether it is known that there will be no page."""
            assert server.address() is None
            return False

        with pytest.raises(TransportError, match="did not start"):
            eventually(never)
        assert late.poll() is not None


@pytest.mark.sweep
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="processes are found as Linux shows them")
@pytest.mark.parametrize(("words", "says"), [("publish", "publisher"), ("serve", "server of the page")])
def test_it_says_that_a_process_of_its_own_ended_too_soon(demo, words, says):
    process = demo("--no-browser", "--seconds", "100")
    url = address_in(process.stdout.readline().decode())
    assert eventually(lambda: alive(url), LIMIT_S)
    (its,) = [one for one in children(process.pid) if words in Path(f"/proc/{one}/cmdline").read_text().split("\0")]
    os.kill(its, signal.SIGKILL)
    _, complaints = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, says in complaints.decode()) == (1, True), complaints


def test_what_it_started_ends_with_it_however_it_ends(demo):
    """Else a killed demonstration goes on simulating for ever, and holds the page's port."""
    process = demo("--no-browser", "--seconds", "100")
    url = address_in(process.stdout.readline().decode())
    assert eventually(lambda: alive(url), LIMIT_S)
    started = children(process.pid)
    assert len(started) == 2
    process.kill()
    process.communicate(timeout=LIMIT_S)
    assert eventually(lambda: not any(map(runs, started)), LIMIT_S)
    assert gone(url)


def test_a_demonstration_of_make_ends_with_it(demo, tmp_path):
    """`make` that is killed passes no signal on."""
    program = script(tmp_path / "make", 'trap "" TERM; "$@" & echo $!; wait')
    words = [program, *COMMAND, "demo", "--no-browser", "--seconds", "100"]
    made = subprocess.Popen(words, cwd=tmp_path, env=environment(MAKELEVEL="1"), stdout=subprocess.PIPE)
    number = int(made.stdout.readline())
    url = address_in(made.stdout.readline().decode())
    made.kill()
    assert eventually(lambda: not runs(number), LIMIT_S)
    made.communicate(timeout=LIMIT_S)
    assert gone(url)


def children(process: int) -> list[int]:
    """Processes that one started."""
    return [int(number) for number in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def runs(process: int) -> bool:
    """Whether a process of that number runs; one that ended and was not asked for yet does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
