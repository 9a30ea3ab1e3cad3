"""What somebody loses if these fail: frames, without a word, because a program wrote into a file that was read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from lidarcodec.errors import SourceError
from lidarcodec.recording import RecordingReader
from tests.command_line import LIMIT_S, environment, run_here
from tests.sweeps import spread

CHANGING = """
import os, sys
from lidarcodec import cli
out, action, *words = sys.argv[1:]
begun = []
def watch(event, given):
    if event == "open" and not begun and f".{out}." in str(given[0]) and "w" in str(given[1]):
        begun.append(True)
        exec(action)
sys.addaudithook(watch)
code = cli.run(words)
assert begun, "the output was never opened"
sys.exit(code)
"""
"""A command whose input changes at the moment at which its output is opened."""

CHANGES = {
    "damaged": "file = open({0!r}, 'r+b'); file.seek({1} // 2); file.write(bytes(99)); file.close()",
    "shorter": "os.truncate({0!r}, {1} // 2)",
    "another": "data = open({2!r}, 'rb').read(); file = open({0!r}, 'r+b'); file.write(data); file.truncate()",
}
"""What becomes of an input: {0} its path, {1} its size, {2} the path of another one."""


def run_changing(action: str, out: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """action: what happens to the input, in Python."""
    given = [sys.executable, "-c", CHANGING, out.stem, action, *map(str, words)]
    return subprocess.run(given, capture_output=True, text=True, env=environment(), timeout=LIMIT_S, check=False)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording, and its halves."""
    folder = tmp_path_factory.mktemp("changing")
    source = "sim:city?frames=8&sensor=vlp16"
    for name, which in (("whole", ()), ("a", ("--frames", 4)), ("b", ("--skip", 4))):
        result = run_here("encode", source, folder / f"{name}.mcap", "--set", "key_interval=1", *which)
        assert result.returncode == 0, result.stderr
    return folder


@pytest.mark.parametrize(("change", "gap"), spread(CHANGES, [(), ("--allow-gap",)]))
def test_parts_that_change_while_they_are_joined_are_no_drive(
    drive: Path, tmp_path: Path, change: str, gap: tuple[str, ...]
) -> None:
    """They were checked before: a frame was missing in the drive, or another stood twice, and the code was 0."""
    first, second, out = drive / "a.mcap", tmp_path / "b.mcap", tmp_path / "drive.mcap"
    second.write_bytes((drive / "b.mcap").read_bytes())
    action = CHANGES[change].format(str(second), second.stat().st_size, str(first))
    result = run_changing(action, out, "join", first, second, out, *gap)
    assert result.returncode == 1, result.stderr
    assert f"{second} changed while it was joined" in result.stderr.splitlines()[-1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.mcap"]


@pytest.mark.parametrize("share", [0.3, 0.9, 0.999])
def test_what_a_recording_lost_while_it_was_read_is_told_as_if_it_had_been_cut_before(
    drive: Path, tmp_path: Path, share: float
) -> None:
    """`decode`, `verify` and `encode` ended with `unexpected DamagedError`."""
    path = tmp_path / "drive.mcap"
    data = (drive / "whole.mcap").read_bytes()
    path.write_bytes(data)
    with path.open("rb") as file:
        reader = RecordingReader(file)
        everything = reader.everything()
        found = [next(everything)]
        with path.open("r+b") as other:
            other.truncate(int(share * len(data)))
        found += everything
    assert 8 * share - 2 <= len(found) <= 8
    assert reader.counts["cut"] or reader.counts["damaged"]
    if share < 0.5:
        with path.open("rb") as file, pytest.raises(SourceError, match="became shorter while it was read"):
            found[-1][1]._replace(source=file, start=len(data) - 10, length=10).data()
