"""A pipe, a device or a folder is named where a file is read: the command says so at once, and waits for nobody."""

from __future__ import annotations

import ast
import os
import re
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from lidarcodec.apps.health import read as read_health
from lidarcodec.commands.certs.command import _read as read_deployment
from lidarcodec.commands.publish.config import read as read_config
from lidarcodec.errors import LidarCodecError
from lidarcodec.files.regular import NotRegularError, check_regular, open_regular
from lidarcodec.network.weight_file import read_weights
from lidarcodec.sensors import read_calibration
from lidarcodec.sources import open_source
from lidarcodec.sources.poses import read_poses
from lidarcodec.sources.recording import RecordingSource
from lidarcodec.transport.config_file import check_config_file
from tests.command_line import run_here, the_one_line

ROOT = Path(__file__).resolve().parents[2]
WAIT_S = 60.0
READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "capture": ("drive.pcap", open_source),
    "recording": ("drive.mcap", RecordingSource),
    "scan": ("0000000000.bin", open_source),
    "folder of scans": ("0000000000.bin", lambda path: open_source(path.parent)),
    "bag in a database": ("bag.db3", open_source),
    "calibration": ("db.xml", read_calibration),
    "poses": ("poses.txt", read_poses),
    "poses in an array": ("poses.npz", read_poses),
    "weights": ("a.lcrw", read_weights),
    "publish --config": ("vehicle.yaml", read_config),
    "--zenoh-config": ("router.json5", check_config_file),
    "deployment": ("deployment.json", lambda path: read_deployment(path, None, None)),
    "health file": ("health.json", read_health),
}


@pytest.fixture
def nobody_waits() -> Iterator[None]:
    """A read that waits for a writer fails the test, instead of standing still with it."""

    def ask(_number: int, _frame: object) -> None:
        raise TimeoutError("it waits for a pipe")

    before = signal.signal(signal.SIGALRM, ask)
    signal.setitimer(signal.ITIMER_REAL, WAIT_S)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("nobody_waits")
@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_refused_by_every_reader(tmp_path: Path, name: str) -> None:
    file, read = READERS[name]
    os.mkfifo(tmp_path / file)
    with pytest.raises((LidarCodecError, OSError), match="it is a pipe; use a regular file"):
        read(tmp_path / file)


@pytest.mark.usefixtures("nobody_waits")
@pytest.mark.parametrize(
    "words",
    [
        ("info", "PIPE"),
        ("verify", "PIPE", "PIPE"),
        ("join", "PIPE.mcap", "PIPE.mcap", "OUT.mcap"),
        ("join", "PIPE.pcap", "PIPE.pcap", "OUT.pcap"),
        ("encode", "sim:city?frames=1", "OUT.mcap", "--calibration", "PIPE"),
        ("encode", "sim:city?frames=1", "OUT.mcap", "--poses", "PIPE"),
        ("decode", "PIPE", "OUT.npz"),
    ],
)
def test_a_command_says_which_file_is_a_pipe(tmp_path: Path, words: tuple[str, ...]) -> None:
    pipe = tmp_path / "pipe"
    names = {f"pipe{Path(word).suffix}" for word in words if word.startswith("PIPE")}
    for name in names:
        os.mkfifo(tmp_path / name)
    given = [word.replace("PIPE", str(pipe)).replace("OUT", str(tmp_path / "out")) for word in words]
    done = run_here(*given)
    assert done.returncode in (1, 2)
    assert str(pipe) in the_one_line(done)
    assert "it is a pipe; use a regular file" in done.stderr
    assert {path.name for path in tmp_path.iterdir()} == names


@pytest.mark.usefixtures("nobody_waits")
def test_each_kind_is_named_and_a_link_to_a_file_is_one(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"bytes")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    with open_regular(tmp_path / "link") as file:
        assert (file.read(), file.name) == (b"bytes", str(tmp_path / "link"))
    with open_regular(tmp_path / "file", buffering=0) as file:
        assert not os.get_inheritable(file.fileno())
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        for path, kind in ((tmp_path / "socket", "a socket"), (tmp_path, "a folder"), (Path("/dev/zero"), "a device")):
            for refuse in (open_regular, check_regular):
                with pytest.raises(NotRegularError, match=f"it is {kind}; use a regular file"):
                    refuse(path)
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "missing")


def test_no_file_is_opened_to_be_read_in_another_way() -> None:
    """`open_regular` is the one door: a reader that opens a file by itself would wait for a pipe."""
    found = []
    for path in (ROOT / "lidarcodec").rglob("*.py"):
        text = path.read_text()
        if not re.search(r"""["']r[bt]?["']""", text):  # to parse all takes seconds
            continue
        calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
        for call in calls:
            name = getattr(call.func, "attr", "") or getattr(call.func, "id", "")
            modes = [word.value for word in call.args if isinstance(word, ast.Constant)]
            if name == "open" and any(mode in ("r", "rb", "rt") for mode in modes):
                found.append(path.relative_to(ROOT).as_posix())
    assert found == ["lidarcodec/files/regular.py"]
