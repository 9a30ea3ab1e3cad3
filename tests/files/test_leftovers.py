"""Hidden files of killed commands fill a disk, and one that is still written must not be taken for such a file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from lidarcodec.files.whole import whole

WRITER = """
import sys
from pathlib import Path
from lidarcodec.files.whole import whole
with whole(Path(sys.argv[1])) as output:
    output.beside.write_text("half of it")
    print(output.beside, flush=True)
    sys.stdin.read()
"""


def old(path: Path) -> Path:
    os.utime(path, (1e9, 1e9))
    return path


def test_what_a_killed_command_left_is_removed_by_the_next_one_and_what_is_written_stays(tmp_path: Path) -> None:
    out = tmp_path / "town.lcmap"
    writer = subprocess.Popen(
        [sys.executable, "-P", "-c", WRITER, str(out)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert writer.stdout is not None
    hidden = old(Path(writer.stdout.readline().strip()))
    others = [
        old(_made(tmp_path / name)) for name in (".town.lcmap", f".city.{'0' * 12}.lcmap", f".town.{'0' * 12}.mcap")
    ]
    (tmp_path / f".town.{'1' * 12}.lcmap").symlink_to(others[0])
    with whole(out) as output:
        output.beside.write_text("all of it")
    assert hidden.exists(), "it is still written"
    writer.send_signal(signal.SIGKILL)
    writer.communicate()
    with whole(out, force=True) as output:
        output.beside.write_text("all of it again")
    assert not hidden.exists()
    assert sorted(tmp_path.iterdir()) == sorted([out, *others, tmp_path / f".town.{'1' * 12}.lcmap"])


def test_a_file_that_has_just_been_made_is_left_alone(tmp_path: Path) -> None:
    """Another command may be about to lock it."""
    young = _made(tmp_path / f".town.{'0' * 12}.lcmap")
    with whole(tmp_path / "town.lcmap") as output:
        output.beside.write_text("all of it")
    assert young.exists()


def _made(path: Path) -> Path:
    path.write_text("x")
    return path
