"""The disk fills up while the vehicle records; what is sent must not notice. The disk is a tmpfs of a few megabytes."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.apps.test_processes import End
from tests.conftest import ROOT
from tests.faults.outcome import PATIENCE_S, Outcome, await_frames, ends, outage_s
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

MEGABYTES = 6


class SmallDisk:
    """A command whose processes see a small disk in a folder: a tmpfs in a mount namespace of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @staticmethod
    def missing() -> str | None:
        """Why there can be none here; None when there can."""
        if shutil.which("unshare") is None:
            return "there is no `unshare`"
        mount = "mount -t tmpfs -o size=1m tmpfs /mnt"
        done = subprocess.run(["unshare", "-rm", "sh", "-c", mount], capture_output=True, text=True, check=False)
        return None if done.returncode == 0 else f"no mount namespace: {done.stderr.strip()}"

    def command(self, *words: str) -> list[str]:
        """The same command, with the small disk."""
        mount = f"mount -t tmpfs -o size={MEGABYTES}m tmpfs {self.folder}"
        return ["unshare", "-rm", "sh", "-c", f'{mount} && exec "$@"', "sh", *words]


class Recording(End):
    """A publisher that records onto a small disk."""

    def __init__(self, disk: SmallDisk, **options: object) -> None:
        words = [
            sys.executable,
            "-m",
            "tests.apps.runner",
            "publish",
            json.dumps(options | {"record": str(disk.folder)}),
        ]
        self._follow(subprocess.Popen(disk.command(*words), cwd=ROOT, stdout=subprocess.PIPE, text=True))


def run() -> Outcome:
    title = f"disk full while recording ({MEGABYTES} MB)"
    why = SmallDisk.missing()
    if why is not None:
        return Outcome(title, None, f"not run: {why}", "-")
    folder = Path(tempfile.mkdtemp())
    port = free_port()
    try:
        with ends() as start:
            office = start("subscribe", loopback_port=port)
            car = Recording(SmallDisk(folder), loopback_port=port)
            try:
                await_frames(office, 5)
                begin_s = time.monotonic()
                full = eventually(lambda: (car.status.get("recording") or {}).get("stopped"), PATIENCE_S)
                await_frames(office, 20)
                step_s = outage_s(office, begin_s)
                recording, status = car.status["recording"], car.status
            finally:
                car.end()
            time.sleep(0.3)
            office.end()
        summary = office.all("summary")[0]
    finally:
        folder.rmdir()
    wrong = [] if full else ["the recorder did not say that the disk is full"]
    wrong += [f"errors: {one}" for one in (summary["errors"], status["errors"]) if one]
    kept = recording["counts"].get("messages", recording["counts"])
    return Outcome(
        title,
        step_s,
        "what would be recorded from then on; nothing that is sent",
        f"publisher: a warning, and `recording.stopped`: {recording['stopped']}",
        {},
        wrong + ([] if kept else ["nothing was recorded before"]),
    )
