"""What an archive costs: processor time a frame, plans and queries of large archives, and a month of a fleet on paper.

    python -m benchmarks.archive [measures|scaling|month ...] [--save]

Large archives are simulated: their objects have the right names, and as much in them as is read. Times are processor
time where they say so, because the machine may be busy with other work. Requests are counted as an object store counts
them: a page of a listing has 1,000 objects.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from benchmarks.fleet import cpu_s
from benchmarks.results import save
from benchmarks.simulated_archive import many_inputs, many_segments, many_tables
from lidarcodec.archive.archive import Archive
from lidarcodec.archive.driver import Outcome, drive
from lidarcodec.archive.engines.here import HereEngine
from lidarcodec.archive.engines.processes import ProcessEngine
from lidarcodec.archive.index import index
from lidarcodec.archive.names import commit_of
from lidarcodec.archive.plan import CompressPlan, archive_settings
from lidarcodec.archive.query import query
from lidarcodec.archive.stores.base import Entry
from lidarcodec.archive.stores.folder import FolderStore
from lidarcodec.archive.tasks import Task
from lidarcodec.commands.settings import one_setting

SCENE: Final = "sim:city?sensor=hdl64e"
CAPTURES, FRAMES = 4, 30
COPIES: Final = 24
"""Of a capture, so that two workers have work for longer than they take to start."""
REAL: Final = ("kitti_sfnd_f000-049.pcap.xz", "kitti_hdl64e_s2_recovered_db.xml")
PAGE: Final = 1000
ROUNDS: Final = 5
"""Of what is compared; the quickest of each counts."""
QUALITIES: Final = {"lossless": [], "within 1 cm": ["max_error_m=0.01"], "within 5 cm": ["max_error_m=0.05"]}
HOURS: Final = 176
"""Of driving of a vehicle in a month: 22 days of 8 hours."""
FPS: Final = 10
VEHICLES: Final = (1, 10, 100)
SEGMENT_S, CAPTURE_S = 40.0, 900.0
WRITES: Final = 3
"""Objects of a segment: recording, table, commit."""
_QUERY: Final = "select vehicle, count(*), sum(bytes) from frames group by vehicle"


class Counted(FolderStore):
    """A folder that counts requests and bytes as an object store would."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.counts: Counter[str] = Counter()

    def entries(self, prefix: str = "", after: str = "") -> Iterator[Entry]:
        for number, entry in enumerate(super().entries(prefix, after)):
            self.counts["lists"] += number % PAGE == 0
            yield entry

    def read(self, name: str, start: int = 0, length: int | None = None) -> bytes:
        data = super().read(name, start, length)
        self.counts["gets"] += 1
        self.counts["bytes"] += len(data)
        return data

    def create(self, name: str, data: bytes | Path) -> bool:
        self.counts["puts"] += 1
        return super().create(name, data)

    def entry(self, name: str) -> Entry | None:
        self.counts["heads"] += 1
        return super().entry(name)


def captures(folder: Path, count: int = CAPTURES) -> Path:
    """A folder with simulated captures."""
    for number in range(count):
        path = folder / "in" / f"car-{number}" / "roof" / "drive.pcap"
        path.parent.mkdir(parents=True)
        words = ["simulate", f"{SCENE}&seed={number}", str(path), "--frames", str(FRAMES)]
        subprocess.run([sys.executable, "-m", "lidarcodec", *words], check=True, stdout=subprocess.DEVNULL)
    return folder / "in"


def real_drive(folder: Path) -> Path:
    """A folder with a real capture and its calibration."""
    data = Path(os.environ.get("LIDARCODEC_DATA", "../shared/data"))
    (target := folder / "in" / "car-0" / "roof").mkdir(parents=True)
    for name in REAL:
        if not (data / name).exists():
            raise SystemExit(f"the month needs {name} in LIDARCODEC_DATA")
        shutil.copy2(data / name, target / ("db.xml" if name.endswith(".xml") else name))
    return folder / "in"


def coded(
    inputs: Path, out: Path, pairs: list[str], workers: int, codec: str = "pcodec"
) -> tuple[Outcome, float, list[float]]:
    """Archive the captures. Returns the outcome, seconds, and processor seconds of this process and of each worker.

    workers: 0 for none: the work is done in this process
    """
    processes = ProcessEngine(workers, 3600.0) if workers else None
    engine = processes or HereEngine()
    plan = CompressPlan(FolderStore(inputs), FolderStore(out), archive_settings(one_setting(codec, pairs)), 5.0)
    begun_s, cpu_begun_s = time.perf_counter(), time.process_time()
    try:
        outcome = drive(plan, engine, FolderStore(out))
        wall_s = time.perf_counter() - begun_s
        spent = [time.process_time() - cpu_begun_s, *(map(cpu_s, processes.pids) if processes else ())]
    finally:
        engine.close()
    if outcome.aside or outcome.left:
        raise SystemExit(f"{outcome.aside} {outcome.left}")
    return outcome, wall_s, spent


def started(folder: Path) -> float:
    """Processor seconds of a worker that has begun with a segment, and found nothing."""
    engine = ProcessEngine(1, 600.0)
    try:
        engine.submit(Task("compress", "none", "none", str(folder), str(folder / "none"), {"input": {"beside": []}}))
        while not engine.ended(60.0):
            pass
        return cpu_s(engine.pids[0])
    finally:
        engine.close()


def measured_here(function: Callable[[], Any]) -> tuple[Any, float, float]:
    """Result, seconds and processor seconds of a function."""
    begun_s, cpu_begun_s = time.perf_counter(), time.process_time()
    result = function()
    return result, time.perf_counter() - begun_s, time.process_time() - cpu_begun_s


def measures() -> str:
    """Two processors against one, an engine against none, large plans, queries and single frames."""
    rows: list[tuple[str, str, str]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs = captures(folder)
        here, one = [], []
        for turn in range(ROUNDS):  # side by side: the machine has quick and slow minutes
            alone, _, spent = coded(inputs, folder / ("here" if turn == 0 else f"here-{turn}"), [], 0)
            here.append(sum(spent))
            one.append(sum(coded(inputs, folder / f"one-{turn}", [], 1)[2]))
        here_s, frames, start_s = min(here), alone.counts["frames"], started(folder)
        more = 100 * ((min(one) - start_s) / here_s - 1)
        source, target = many_segments(folder / "segments", 10_000)
        _, wall_s, spent_s = measured_here(lambda: _again(source, target))
        rows += [
            ("a frame in one process: processor time", f"{here_s / frames * 1e3:.1f} ms", "-"),
            ("start of a worker: processor time", f"{start_s:.1f} s", "-"),
            ("more with a worker than in one process, without its start", f"{more:+.1f} %", "10 %"),
            *_two_against_one(folder, inputs),
            ("second run, 10,000 segments", f"{wall_s:.2f} s, {spent_s:.2f} s", "2 s"),
            ("plan of 100,000 inputs, and its memory", _large_plan(folder / "inputs"), "30 s, 500 MB"),
        ]
        store = FolderStore(many_tables(folder / "tables", 2500, 400))
        _, wall_s, spent_s = measured_here(lambda: query(store, _QUERY))
        rows.append(("query of 1,000,000 frames, 2,500 tables", f"{wall_s:.2f} s, {spent_s:.2f} s", "-"))
        index(store)
        _, wall_s, spent_s = measured_here(lambda: query(store, _QUERY))
        rows.append(("the same, joined", f"{wall_s:.2f} s, {spent_s:.2f} s", "1 s"))
        rows += _one_frame(folder)
        coded(inputs, folder / "memory", [], 0, "predictive")
        rows.append(_late_frame(FolderStore(folder / "memory"), Counted(folder / "memory")))
    lines = ["| | measured | asked |", "|---|---:|---:|", *(f"| {' | '.join(row)} |" for row in rows)]
    about = (
        f"{CAPTURES} captures of {SCENE}, {FRAMES} frames each, pcodec, lossless. Large archives are simulated, in "
        f"a folder. Pairs are time and processor time. What is compared ran {ROUNDS} times in turn. The quickest "
        "counts, of two workers the median pair."
    )
    return f"# What an archive costs\n\n{about}\n\n" + "\n".join(lines) + "\n"


def scaling() -> str:
    """Two workers against one, alone. It needs a machine with two processors and nothing else to do."""
    with tempfile.TemporaryDirectory() as name:
        rows = _two_against_one(Path(name), captures(Path(name), 1))
    lines = ["| | measured | asked |", "|---|---:|---:|", *(f"| {' | '.join(row)} |" for row in rows)]
    about = f"{COPIES} copies of a capture of {SCENE}, {FRAMES} frames each, pcodec, lossless. Starts are included."
    return f"# Two workers against one\n\n{about}\n\n" + "\n".join(lines) + "\n"


def _two_against_one(folder: Path, inputs: Path) -> list[tuple[str, str, str]]:
    """Time and processor time of the same work with one worker and with two, side by side."""
    for number in range(COPIES):
        shutil.copytree(inputs / "car-0", folder / "copies" / f"car-{number}")
    pairs = []
    for turn in range(ROUNDS):
        _, one_s, one = coded(folder / "copies", folder / f"by-one-{turn}", [], 1)
        _, two_s, two = coded(folder / "copies", folder / f"by-two-{turn}", [], 2)
        pairs.append((one_s / two_s, sum(two) / sum(one), one_s, two_s))
    times, slower, one_s, two_s = sorted(pairs)[len(pairs) // 2]
    return [
        ("two workers against one: time", f"{times:.2f} times: {one_s:.1f} s, {two_s:.1f} s", "1.8 times"),
        ("the same: how much more processor time the same frames take then", f"{100 * (slower - 1):+.0f} %", "-"),
        ("the same, if a processor were as quick beside another busy one", f"{times * slower:.2f} times", "1.8 times"),
    ]


def _again(inputs: Path, archive: Path) -> None:
    """What a second run does."""
    source, target = FolderStore(inputs), FolderStore(archive)
    plan = CompressPlan(source, target, archive_settings(one_setting("pcodec", [])), 40.0)
    if list(plan.tasks()) or index(target)["joined"]:
        raise SystemExit("a second run has something to do")


def _large_plan(folder: Path) -> str:
    """Time and memory of a plan of 100,000 inputs, in a process of its own."""
    many_inputs(folder, 100_000)
    program = (
        "import resource, sys, time\n"
        "from pathlib import Path\n"
        "from lidarcodec.archive.plan import CompressPlan, archive_settings\n"
        "from lidarcodec.archive.stores.folder import FolderStore\n"
        "from lidarcodec.settings import StreamSettings\n"
        "a, out = FolderStore(Path(sys.argv[1])), FolderStore(Path(sys.argv[1]) / 'out')\n"
        "begun_s = time.perf_counter()\n"
        "count = sum(1 for _ in CompressPlan(a, out, archive_settings(StreamSettings()), 40.0).tasks())\n"
        "used = resource.getrusage(resource.RUSAGE_SELF)\n"
        "print(count, time.perf_counter() - begun_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(folder)], check=True, capture_output=True, text=True)
    count, wall_s, spent_s, memory = map(float, done.stdout.split())
    if count != 100_000:
        raise SystemExit(f"the plan has {count} tasks")
    return f"{wall_s:.1f} s, {spent_s:.1f} s, {memory:.0f} MB"


def _one_frame(folder: Path) -> list[tuple[str, str, str]]:
    """Requests and bytes of one frame, in an archive with 10,000 further segments of its sensor."""
    store = Counted(folder / "here")
    commit = next(one for entry in store.entries("commits/car-0/") if (one := commit_of(entry.name)) is not None)
    for number in range(10_000):
        later = commit.first_ns + (number + 1) * 40 * 10**9
        ident = f"{number:024x}"
        other = commit._replace(first_ns=later, last_ns=later + 39 * 10**9, segment=ident, origin=ident)
        (folder / "here" / other.name).write_bytes(b"{}")
    stamp = commit.first_ns
    store.counts.clear()
    (frame,) = Archive(store).frames(vehicle="car-0", sensor="roof", between=(stamp, stamp))
    length = json.loads((folder / "here" / commit.name).read_text())["messages"][frame.index][2]
    requests = store.counts["lists"] + store.counts["gets"]
    read = store.counts["bytes"]
    return [
        ("one frame of 10,000 segments: requests", str(requests), "3"),
        ("the same: bytes", f"{read:,}, {read / length:.2f} times its own", "2 times"),
    ]


def _late_frame(plain: FolderStore, store: Counted) -> tuple[str, str, str]:
    """Bytes of the last frame of a segment whose codec has a memory, against those since its key message."""
    commit = next(one for entry in plain.entries("commits/car-0/") if (one := commit_of(entry.name)) is not None)
    messages = json.loads(plain.read(commit.name))["messages"]
    (frame,) = Archive(store).frames(vehicle="car-0", sensor="roof", between=(commit.last_ns, commit.last_ns))
    if frame.stamp_ns != commit.last_ns:
        raise SystemExit("another frame was read")
    key = max(number for number, message in enumerate(messages) if message[6])
    since = sum(message[2] for message in messages[key:])
    read = store.counts["bytes"]
    return ("one frame of `predictive`: bytes", f"{read:,}, {read / since:.2f} times those since its key", "2 times")


def month() -> str:
    """A month of a fleet, from the measured cost of a frame."""
    lines = ["| quality | vehicles | core-hours | GB in | GB kept | writes |", "|---|---:|---:|---:|---:|---:|"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs = real_drive(folder)
        for number, (quality, pairs) in enumerate(QUALITIES.items()):
            outcome, _, (spent_s,) = coded(inputs, folder / str(number), pairs, 0)
            frames = outcome.counts["frames"]
            for vehicles in VEHICLES:
                total = vehicles * HOURS * 3600 * FPS
                segments, files = vehicles * HOURS * 3600 / SEGMENT_S, vehicles * HOURS * 3600 / CAPTURE_S
                values = [
                    f"{total * spent_s / frames / 3600:,.0f}",
                    f"{total * outcome.counts['packet_bytes'] / frames / 1e9:,.0f}",
                    f"{total * outcome.counts['bytes'] / frames / 1e9:,.0f}",
                    f"{WRITES * segments + files:,.0f}",
                ]
                lines.append(f"| {quality} | {vehicles} | {' | '.join(values)} |")
    about = (
        f"A vehicle drives {HOURS} hours a month with one HDL-64E at {FPS} turns a second. Cost and size of a frame "
        f"are those of {frames} frames of a real drive ({REAL[0]}), coded with pcodec, decoded and compared. A core "
        f"is a processor of the machine named here. Writes are {WRITES} for a segment of {SEGMENT_S:g} s and one for a "
        f"capture of {CAPTURE_S / 60:g} minutes."
    )
    return f"# A month of a fleet, on paper\n\n{about}\n\n" + "\n".join(lines) + "\n"


def main() -> int:
    """Measure, print, and with --save keep the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.archive", description=__doc__)
    parser.add_argument("what", nargs="*", default=["measures", "month"])
    parser.add_argument("--save", action="store_true")
    chosen = parser.parse_args()
    for name in chosen.what:
        text = {"measures": measures, "scaling": scaling, "month": month}[name]()
        print(text, flush=True)
        if chosen.save:
            save(f"archive/{name}", text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
