"""Somebody presses Ctrl-C, at any moment: `encode && rm` must not delete the only copy of a drive."""

from __future__ import annotations

import json
import os
import random
import shlex
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import packets as made
from tests.command_line import COMMAND, environment, run_here, start
from tests.drives import simulated
from tests.packets import payloads_in
from tests.sweeps import sampled
from tests.transport.conftest import free_port

FRAMES = 6
SOURCE = f"sim:city?frames={FRAMES}"
MOMENTS = sampled([3, 20], [3])
"""How many of each command: seeded, from before it listens to the end of its work."""
SIGNALS = sampled([signal.SIGINT, signal.SIGTERM], [signal.SIGTERM])


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a capture and its recording."""
    folder = tmp_path_factory.mktemp("drive")
    simulated(SOURCE, folder / "drive.pcap")
    assert run_here("encode", folder / "drive.pcap", folder / "drive.mcap").returncode == 0
    return folder


def interrupted(words: list[object], after_s: float, number: int = signal.SIGINT) -> subprocess.CompletedProcess[str]:
    """A command that gets a signal after so long."""
    process = start(*words)
    try:
        time.sleep(after_s)
        process.send_signal(number)
        out, complaint = process.communicate(timeout=60)
    finally:
        process.kill()
    return subprocess.CompletedProcess(words, process.returncode, out, complaint)


def interrupted_while_writing(words: list[object], folder: Path, number: int) -> subprocess.CompletedProcess[str]:
    """A command that gets a signal when it has begun to write."""
    process = start(*words)
    try:
        limit = time.monotonic() + 60
        while time.monotonic() < limit and process.poll() is None and not begun(folder):
            time.sleep(0.02)
        process.send_signal(number)
        out, complaint = process.communicate(timeout=60)
    finally:
        process.kill()
    return subprocess.CompletedProcess(words, process.returncode, out, complaint)


def begun(folder: Path) -> bool:
    """Whether a hidden output holds something of note."""
    for hidden in folder.glob(".*"):
        files = list(hidden.iterdir()) if hidden.is_dir() else [hidden]
        if sum(file.stat().st_size for file in files if file.exists()) > 500_000:
            return True
    return False


def advised(complaint: str) -> Iterator[list[str]]:
    """Words of the commands that a stopped one prints."""
    for line in complaint.splitlines():
        if ": lidarcodec " in line or ":  lidarcodec " in line:
            yield shlex.split(line.partition("lidarcodec ")[2])
        elif " lidarcodec " in line:
            yield shlex.split(line.partition(" lidarcodec ")[2])


def all_together(complaint: str, out: Path) -> list[bytes]:
    """The packets of `out`, after what a stopped command says was done."""
    for words in advised(complaint):
        done = run_here(*words)
        assert done.returncode == 0, done.stderr
    return payloads_in(out)


def check(result: subprocess.CompletedProcess[str], folder: Path, out: Path, whole: list[bytes], code: int) -> bool:
    """What has to be true at any moment; whether something was kept."""
    parts = [path for path in folder.iterdir() if ".partial" in path.name and not path.name.endswith(".xml")]
    assert not list(folder.glob(".*")), "a hidden file is left over"
    if result.returncode == 0:  # the signal came when all was done
        assert payloads_in(out) == whole
        assert not parts
        return False
    if result.returncode == -signal.SIGINT:  # Python itself was starting
        assert not parts
        assert not out.exists()
        return False
    assert result.returncode == code, result.stderr
    assert not out.exists()
    assert len(parts) <= 1
    if parts:
        assert payloads_in(parts[0]) == whole[: len(payloads_in(parts[0]))]
        assert all_together(result.stderr, out) == whole
    return bool(parts)


@pytest.mark.timeout(600)  # twenty runs on a busy machine
@pytest.mark.parametrize("moments", MOMENTS)
@pytest.mark.parametrize("command", sampled(["encode", "convert", "decode"], ["encode"]))
def test_at_any_moment_an_output_is_whole_or_a_part_that_can_be_completed(
    drive: Path, tmp_path: Path, command: str, moments: int
) -> None:
    source = drive / ("drive.mcap" if command == "decode" else "drive.pcap")
    whole = payloads_in(drive / "drive.pcap")
    chance = random.Random(27)
    began = time.monotonic()
    ending = ".mcap" if command == "encode" else ".pcap"
    assert start(command, source, tmp_path / f"all{ending}").wait(60) == 0
    took_s = time.monotonic() - began
    for number in range(moments):
        folder = tmp_path / str(number)
        folder.mkdir()
        out = folder / f"out{ending}"
        result = interrupted([command, source, out], chance.uniform(0.02, 1.05) * took_s)
        check(result, folder, out, whole, 130)


@pytest.mark.timeout(600)  # twenty runs on a busy machine
@pytest.mark.parametrize("moments", MOMENTS)
def test_at_any_moment_verify_says_that_it_compared_all_or_that_it_did_not(drive: Path, moments: int) -> None:
    words: list[object] = ["verify", drive / "drive.mcap", drive / "drive.pcap", "--json"]
    chance = random.Random(27)
    began = time.monotonic()
    assert start(*words).wait(60) == 0
    took_s = time.monotonic() - began
    for _ in range(moments):
        result = interrupted(words, chance.uniform(0.02, 1.05) * took_s)
        assert result.returncode in (0, 130, -signal.SIGINT), result.stderr
        found = json.loads(result.stdout) if result.stdout else {"complete": False, "interrupted": True}
        assert (found["complete"], found["interrupted"]) == (result.returncode == 0, result.returncode != 0)


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize(
    ("command", "source", "name"),
    [
        ("encode", "sim:city?frames=100000", "out.mcap"),
        ("convert", "sim:city?frames=100000", "out.pcap"),
        ("convert", "sim:city?frames=100000", "bag"),
        ("simulate", "sim:city?frames=100000", "out.pcap"),
    ],
)
def test_what_is_done_is_kept_under_another_name(
    tmp_path: Path, number: int, command: str, source: str, name: str
) -> None:
    result = interrupted_while_writing([command, source, tmp_path / name], tmp_path, number)
    out = tmp_path / name
    part = next(path for path in tmp_path.iterdir() if path.name.startswith(f"{out.stem}.partial{out.suffix}"))
    assert result.returncode == 128 + number, result.stderr
    assert not out.exists()
    found = payloads_in(part)
    frames = round(len(found) / 359)  # turns of the simulator have 358 to 360 packets
    assert abs(len(found) - 359 * frames) <= frames // 2
    assert frames > 0
    assert f"stopped: {frames} frames are kept in {part}" in result.stderr
    rest, *_ = advised(result.stderr)
    assert rest[:3] == [command, "--skip", str(frames)]
    assert not list(tmp_path.glob(".*"))


def test_a_part_is_numbered_if_there_is_one_and_the_rest_of_the_rest_can_be_done(drive: Path, tmp_path: Path) -> None:
    for name in ("out.partial.pcap", "out.rest.pcap"):
        (tmp_path / name).write_text("mine")
    words = ["convert", "sim:city?frames=100000", tmp_path / "out.pcap"]
    result = interrupted_while_writing(words, tmp_path, signal.SIGTERM)
    assert result.returncode == 143
    assert (tmp_path / "out.partial.pcap").read_text() == "mine"
    assert (tmp_path / "out.partial-2.pcap").stat().st_size > 400_000
    rest, both = advised(result.stderr)
    assert rest[-1] == str(tmp_path / "out.rest-2.pcap")
    assert both[1:] == [str(tmp_path / f"out{end}.pcap") for end in (".partial-2", ".rest-2", "")]


def encoded_by(program: str, source: str, out: Path) -> subprocess.CompletedProcess[str]:
    """`encode` in a process that runs a program before."""
    code = f"{program}from lidarcodec.__main__ import main\nmain()"
    words = [COMMAND[0], "-c", code, "encode", source, str(out)]
    return subprocess.run(words, capture_output=True, text=True, env=environment(), timeout=60, check=False)


@pytest.mark.sweep
def test_a_second_signal_ends_it_at_once_with_nothing_to_be_seen(tmp_path: Path) -> None:
    """The second one comes while the first still waits for a frame that never ends."""
    program = (
        "import os, signal, sys, time\n"
        "from lidarcodec.evaluation import coded_recording\n"
        "def slow(self, frame):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    time.sleep(1.1)\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    time.sleep(60)\n"
        "coded_recording.CodedRecording.write = slow\n"
    )
    done = encoded_by(program, "sim:city?frames=3", tmp_path / "out.mcap")
    assert (done.returncode, done.stderr) == (130, "lidarcodec: stopped before it was finished\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.sweep
def test_a_signal_that_comes_when_all_is_done_does_not_make_it_a_part(tmp_path: Path) -> None:
    program = (
        "import os, signal\n"
        "from lidarcodec.evaluation import coded_recording\n"
        "close = coded_recording.CodedRecording.close\n"
        "def interrupted(self):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    close(self)\n"
        "coded_recording.CodedRecording.close = interrupted\n"
    )
    done = encoded_by(program, "sim:city?frames=2", tmp_path / "out.mcap")
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"]
    assert len(payloads_in(tmp_path / "out.mcap")) == 718


@pytest.mark.parametrize("number", SIGNALS)
def test_a_shell_does_not_go_on_behind_it(tmp_path: Path, number: int) -> None:
    precious = tmp_path / "precious"
    precious.write_text("the only copy")
    command = shlex.join([*COMMAND, "encode", "sim:city?frames=100000", str(tmp_path / "out.mcap")])
    shell = subprocess.Popen(
        ["sh", "-c", f"{command} && rm {shlex.quote(str(precious))}"],
        env=environment(), start_new_session=True, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        limit = time.monotonic() + 60
        while time.monotonic() < limit and not begun(tmp_path):
            time.sleep(0.02)
        children = Path(f"/proc/{shell.pid}/task/{shell.pid}/children").read_text().split()
        os.kill(int(children[0]), number)
        shell.communicate(timeout=60)
    finally:
        shell.kill()
    assert precious.exists()


def test_a_terminal_that_is_closed_leaves_nothing_behind(tmp_path: Path) -> None:
    result = interrupted_while_writing(
        ["encode", "sim:city?frames=100000", tmp_path / "out.mcap"], tmp_path, signal.SIGHUP
    )
    assert result.returncode == 129
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("words", "code"), [((), 1), (("--allow-part",), 0)])
def test_a_verdict_counts_though_nobody_reads_it(
    drive: Path, tmp_path: Path, words: tuple[str, ...], code: int
) -> None:
    part = tmp_path / "part.mcap"
    assert run_here("encode", drive / "drive.pcap", part, "--frames", 1).returncode == 0
    process = start("verify", part, drive / "drive.pcap", *words)
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(60) == code


def test_a_pipe_that_nobody_reads_any_more_is_an_error(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.pcap"
    os.mkfifo(pipe)
    process = start("simulate", "sim:city?frames=100", pipe)
    with pipe.open("rb") as reader:
        assert len(reader.read(1000)) == 1000
    _, complaint = process.communicate(timeout=60)
    assert (process.returncode, "Broken pipe" in complaint) == (1, True)


def test_a_live_source_without_a_number_of_frames_ends_with_a_signal_and_that_is_all_of_it(tmp_path: Path) -> None:
    packets = made.turning(400)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("127.0.0.1", 0))
        port = free_port()
        for words, code, name in (((), 0, "out.mcap"), (("--frames", 9), 130, "out.partial.mcap")):
            folder = tmp_path / str(code)
            folder.mkdir()
            process = start("encode", f"udp://127.0.0.1:{port}", folder / "out.mcap", *words)
            limit = time.monotonic() + 60
            while time.monotonic() < limit and not any(path.stat().st_size > 1000 for path in folder.glob(".*")):
                for packet in packets:
                    sender.sendto(packet.payload, ("127.0.0.1", port))
                time.sleep(0.1)
            process.send_signal(signal.SIGINT)
            _, complaint = process.communicate(timeout=60)
            assert process.returncode == code, complaint
            assert [path.name for path in folder.iterdir()] == [name]


def test_a_part_has_its_calibration_though_the_whole_has_it_already(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "out_db.xml").write_bytes((drive / "drive_db.xml").read_bytes())
    words = ["convert", "sim:city?frames=100000", tmp_path / "out.pcap", "--calibration", drive / "drive_db.xml"]
    result = interrupted_while_writing(words, tmp_path, signal.SIGINT)
    assert result.returncode == 130
    assert (tmp_path / "out.partial_db.xml").read_bytes() == (tmp_path / "out_db.xml").read_bytes()


@pytest.mark.parametrize("framing", sampled(["packets:50", "revolution"], ["packets:50"]))
@pytest.mark.sweep
def test_the_rest_of_a_recording_is_counted_in_its_own_frames(tmp_path: Path, framing: str) -> None:
    """`convert` counted turns of 348 packets, whatever frames it wrote, and `join` refused the parts."""
    words = ["convert", "sim:city?frames=12", tmp_path / "out.mcap", "--codec", "raw", "--set", f"framing={framing}"]
    result = interrupted_while_writing(list(words), tmp_path, signal.SIGINT)
    whole = payloads_in("sim:city?frames=12")
    assert result.returncode == 130, result.stderr
    assert check(result, tmp_path, tmp_path / "out.mcap", whole, 130)


@pytest.mark.parametrize(("command", "ending"), [("encode", ".mcap"), ("simulate", ".pcap")])
def test_a_name_as_long_as_a_file_system_allows_has_room_for_that_of_its_part(
    tmp_path: Path, command: str, ending: str
) -> None:
    out = tmp_path / ("ä" * 122 + "x" * 2 + ending)  # 251 bytes: a calibration beside it has two more
    result = interrupted_while_writing([command, "sim:city?frames=100000", out], tmp_path, signal.SIGINT)
    assert result.returncode == 130, result.stderr
    part = next(path for path in tmp_path.iterdir() if ".partial" in path.name and path.suffix == ending)
    assert (len(payloads_in(part)) + 5) % 359 <= 5  # whole turns
    rest, both = advised(result.stderr)
    assert (rest[0], both[0], both[-1]) == (command, "join", str(out))
    assert all(len(os.fsencode(Path(word).name)) <= 255 for word in (*rest, *both))


def test_what_a_live_sensor_sent_last_is_in_the_recording(tmp_path: Path) -> None:
    """The last frame was lost without a word: a whole one waits for the packet behind it, a part for its rest."""
    packets = made.turning(400)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("127.0.0.1", 0))
        port = free_port()
        process = start("encode", f"udp://127.0.0.1:{port}", tmp_path / "out.mcap")
        limit = time.monotonic() + 60
        while time.monotonic() < limit and f":{port:04X} " not in Path("/proc/net/udp").read_text():
            time.sleep(0.02)
        for packet in packets:
            sender.sendto(packet.payload, ("127.0.0.1", port))
            time.sleep(0.002)  # a socket holds 92 of them while nobody reads
        time.sleep(1.5)  # more than it waits for a calibration
        process.send_signal(signal.SIGINT)
        _, complaint = process.communicate(timeout=60)
    assert process.returncode == 0, complaint
    assert payloads_in(tmp_path / "out.mcap") == [packet.payload for packet in packets]
