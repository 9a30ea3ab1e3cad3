"""Workers and the driver of `archive run` are killed (SIGKILL) at random moments, until the archive is complete."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

from tests import command_line
from tests.faults.outcome import Outcome

KILLS = 100
SEED = 33
DRIVES = 4
"""Enough segments that their tables are joined at the end."""
FRAMES = 40
DRIVER_SHARE = 0.2
"""Share of the kills that hit the driver."""
EARLY_SHARE = 0.25
"""Share of the moments before there are workers at which the driver is killed: a slow machine has many of them."""
KILLS_OF_A_ROUND = 12
"""Killed more often, a short archive would never be complete."""
PATIENCE_S = 300.0
TWO = ("--processes", "2")


def run(kills: int = KILLS, seed: int = SEED) -> Outcome:
    """Rounds with a fresh archive each, until so many processes were killed."""
    moments = random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        expected = undisturbed(folder)
        counts = {"workers": 0, "drivers": 0, "rounds": 0}
        wrong: list[str] = []
        while counts["workers"] + counts["drivers"] < kills:
            counts["rounds"] += 1
            out = f"round-{counts['rounds']}"
            disturbed(folder, out, moments, counts, kills)
            if objects(folder / out) != expected:
                wrong.append(f"{out} has other objects than an undisturbed run")
            repaired = command_line.run("archive", *words(folder, out), "--repair")
            every = {path for path in (folder / out).rglob("*") if path.is_file()}
            if repaired.returncode or len(every) != len(expected):
                wrong.append(f"{out}: files are left behind after --repair")
            shutil.rmtree(folder / out)
    total = counts["workers"] + counts["drivers"]
    return Outcome(
        "workers and driver of `archive run` killed",
        None,
        "nothing: the same objects, byte for byte, as of an undisturbed run",
        "driver: `tried_again`; a killed driver is started again",
        {"note": f"{total} kills, {counts['drivers']} of them of the driver"},
        wrong,
    )


def undisturbed(folder: Path) -> dict[str, bytes]:
    """Inputs in a folder, and the objects of an archive of them that nothing disturbed."""
    for number in range(DRIVES):
        path = folder / "in" / f"car-{number}" / "roof" / "drive.pcap"
        path.parent.mkdir(parents=True)
        made = command_line.run("simulate", f"sim:city?sensor=vlp16&seed={number}", path, "--frames", FRAMES)
        if made.returncode:
            raise RuntimeError(made.stderr)
    done = command_line.run("archive", *words(folder, "undisturbed"))
    if done.returncode:
        raise RuntimeError(done.stderr)
    return objects(folder / "undisturbed")


def words(folder: Path, out: str, *workers: str) -> list[str]:
    """Words of a run with segments of a second."""
    return ["run", str(folder / "in"), str(folder / out), "--seconds", "1", *(workers or TWO), "--json"]


def objects(folder: Path) -> dict[str, bytes]:
    """Everything that is visible in an archive."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".")
    }


def disturbed(folder: Path, out: str, moments: random.Random, counts: dict[str, int], kills: int) -> None:
    """One archive, from nothing to complete. Raises TimeoutError if it does not become complete."""
    orphans: set[int] = set()
    begun_s, in_round = time.monotonic(), 0
    while True:
        driver = command_line.start("archive", *words(folder, out))
        while driver.poll() is None:
            if time.monotonic() - begun_s > PATIENCE_S:
                driver.kill()
                raise TimeoutError(f"{out} is not complete after {PATIENCE_S:g} s")
            with contextlib.suppress(subprocess.TimeoutExpired):
                driver.wait(moments.uniform(0.1, 3.0))
                break
            if in_round == KILLS_OF_A_ROUND or counts["workers"] + counts["drivers"] >= kills:
                continue
            children = workers_of(driver.pid)
            orphans |= children
            before = counts["workers"] + counts["drivers"]
            early = not children and moments.random() > EARLY_SHARE
            if moments.random() < DRIVER_SHARE and not early:
                driver.kill()
                counts["drivers"] += 1
            elif children:
                _kill(moments.choice(sorted(children)))
                counts["workers"] += 1
            in_round += counts["workers"] + counts["drivers"] - before
        driver.communicate()
        if driver.returncode == 0:
            break
        if driver.returncode != -signal.SIGKILL:
            raise RuntimeError(f"the driver ended with {driver.returncode}")
    for pid in orphans:
        while _runs(pid) and time.monotonic() - begun_s < PATIENCE_S:
            time.sleep(0.05)
        _kill(pid)


def workers_of(pid: int) -> set[int]:
    """Worker processes of a driver."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(path.read_text().rpartition(")")[2].split()[1]) == pid:
                command = path.with_name("cmdline").read_bytes()
                if b"lidarcodec.archive.engines.worker" in command:
                    found.add(int(path.parent.name))
    return found


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
