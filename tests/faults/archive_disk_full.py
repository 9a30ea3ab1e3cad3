"""The disk of an archive fills up while it is written, or the one for files in the making. Both are a small tmpfs.

A run on the full disk must end with exit code 1 and leave nothing half; the next one, with room, completes the archive.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

from tests import command_line
from tests.faults.archive_killed import objects, undisturbed, words
from tests.faults.disk_full import SmallDisk
from tests.faults.outcome import Outcome

SHARES = (0.35, 0.9)
"""Of the bytes of the whole archive, those that fit on the disk."""
SCRATCH = 200_000
"""Bytes for files in the making: a segment needs more."""
PATIENCE_S = 300.0


def run() -> Outcome:
    title = "disk full while `archive run` writes"
    if (why := SmallDisk.missing()) is not None:
        return Outcome(title, None, "?", "?", {"note": f"not run: {why}"})
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        expected = undisturbed(folder)
        size = sum(map(len, expected.values()))
        for share in SHARES:
            small = folder / f"small-{share}"
            told = _on_small_disk(folder, small, int(size * share))
            kept = objects(small)
            if told["returncode"] != 1 or not told["left"]:
                wrong.append(f"with room for {share:.0%}: exit code {told['returncode']}, left {told['left']}")
            if wrongly := [one for one, data in kept.items() if expected.get(one) != data]:
                wrong.append(f"with room for {share:.0%}: {wrongly[0]} is not that of an undisturbed run")
            done = command_line.run("archive", *words(folder, small.name))
            if done.returncode or objects(small) != expected:
                wrong.append(f"with room again after {share:.0%}: other objects than of an undisturbed run")
            shutil.rmtree(small)
        wrong += _scratch_full(folder, expected)
    rooms = ", ".join(f"{share:.0%}" for share in SHARES)
    return Outcome(
        title,
        None,
        "nothing: with room again the next run completes it, with the same objects, byte for byte",
        "driver: `left` with the reason, exit code 1",
        {"note": f"room for {rooms} of the archive, and too little for files in the making"},
        wrong,
    )


def _scratch_full(folder: Path, expected: dict[str, bytes]) -> list[str]:
    """What goes wrong if there is no room for files in the making."""
    disk = folder / "disk"
    command = [*command_line.COMMAND, "archive", *words(folder, "scratched")]
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", f'mount -t tmpfs -o size={SCRATCH} tmpfs {disk} && "$@"', "sh", *command],
        capture_output=True, text=True, env=command_line.environment(TMPDIR=str(disk)), timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    left = json.loads(done.stdout)["left"] if done.stdout else []
    wrong = [] if done.returncode == 1 and left else [f"no room in TMPDIR: exit code {done.returncode}, left {left}"]
    again = command_line.run("archive", *words(folder, "scratched"))
    if again.returncode or objects(folder / "scratched") != expected:
        wrong.append("with room in TMPDIR again: other objects than of an undisturbed run")
    return wrong


def _on_small_disk(folder: Path, out: Path, room: int) -> dict[str, object]:
    """Run on a disk with so much room, and copy what is there then to `out`, hidden files as well."""
    disk = folder / "disk"
    disk.mkdir(exist_ok=True)
    command = [*command_line.COMMAND, "archive", *words(folder, "disk")]
    script = (
        f"mount -t tmpfs -o size={room} tmpfs {disk} && cd {folder} && "
        f'{{ "$@"; code=$?; cp -a {disk} {out}; exit $code; }}'
    )
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", script, "sh", *command],
        capture_output=True, text=True, env=command_line.environment(), timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    left = json.loads(done.stdout)["left"] if done.stdout else done.stderr[-300:]
    return {"returncode": done.returncode, "left": left}
