"""`target_kbps=auto` against plain policies, on a link that is cut and restored while the stream runs.

    python -m benchmarks.adaptive [--link namespaces|relay] [--source CAPTURE] [--policy auto]... [--json] [--save]

The link carries 20, 4, 1, 0.4, then 20 Mbit/s again. All settings but the target are defaults. There is a row for each
policy and part of the run, without the first 2 seconds of the part: latency from a frame's last packet to the decoded
frame, frames shown a second, age of the newest frame shown (looked at every 10 ms), RMSE and largest error of measured
ranges, the step between the columns that were sent, and after the last change how long until the target was back at
nine tenths of the first. --save writes benchmarks/results/links/LINK.csv, from which `make evidence` writes the table.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import results
from benchmarks.link_ends import PLAIN
from benchmarks.links import Link, Namespaces, Relayed
from lidarcodec.transport.endpoints import free_port

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT.parent / "shared" / "data" / "kitti_0005.pcap.xz"
PARTS = ((20_000.0, 10.0), (4_000.0, 12.0), (1_000.0, 12.0), (400.0, 14.0), (20_000.0, 14.0))
"""Kbit/s and seconds of each part."""
TITLES = {
    "namespaces": "A link that changes: two network namespaces joined by `tc tbf`",
    "relay": "A link that changes: a relay on loopback with megabytes of buffers, as behind a modem with a long queue",
}
ABOUT = "KITTI 0005, defaults but for the target. Without the first 2 seconds after each change of the link."
ADAPTING_S = 2.0
READY_S = 60.0
BACK = 0.9
FIXED = {"max_error_m": 0.0, "key_interval": 10}
POLICIES: dict[str, dict[str, Any]] = {
    "auto": {"target_kbps": "auto"},
    "one in flight": FIXED,
    **dict.fromkeys(PLAIN, FIXED),
}
"""Settings under each name; those but the first two are the library's own policies, without reports or mailbox."""


class End:
    """A process of benchmarks.link_ends on its side of a link, and what it has said."""

    def __init__(self, link: Link, role: str, side: str, **options: Any) -> None:
        command = [sys.executable, "-m", "benchmarks.link_ends", role, json.dumps(options)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        self._process = subprocess.Popen(
            link.command(side, command), cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment
        )
        self.said: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        for line in self._process.stdout or ():
            if line.startswith("{"):  # the network library also logs here
                self.said.append(json.loads(line))

    def wait(self, word: str, seconds: float = READY_S) -> None:
        """Until it has said something with that word. Raises TimeoutError."""
        end = time.monotonic() + seconds
        while not any(word in one for one in list(self.said)):
            if time.monotonic() > end or self._process.poll() is not None:
                raise TimeoutError(f"no '{word}' from the process")
            time.sleep(0.05)

    def end(self) -> None:
        """SIGTERM, and wait."""
        if self._process.poll() is None:
            self._process.terminate()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._thread.join(5)
        if self._process.stdout is not None:
            self._process.stdout.close()


def percentile(values: Sequence[float], q: float) -> float | None:
    """The value that a share `q` does not exceed, rounded; None of none."""
    ordered = sorted(values)
    return round(ordered[min(len(ordered) - 1, int(q * len(ordered)))], 1) if ordered else None


def play(
    link: Link,
    policy: str,
    source: str,
    parts: Sequence[tuple[float, float]] = PARTS,
    keep: Path | None = None,
    **settings: Any,
) -> tuple[list[float], End, End]:
    """Host times at which the parts began, the last entry the end, and the two ends with all they said.

    keep: folder for the frames that were received and compared
    """
    link.rate(parts[0][0])
    kept = {} if keep is None else {"keep": str(keep)}
    receiver = End(link, "receive", "receiver", policy=policy, source=source, connect=link.connect, **kept)
    receiver.wait("ready")
    chosen = POLICIES[policy] | settings
    publisher = End(link, "publish", "publisher", policy=policy, source=source, listen=link.listen, settings=chosen)
    times = []
    try:
        receiver.wait("index")
        for kbit, seconds in parts:
            link.rate(kbit)
            times.append(time.time())
            time.sleep(seconds)
        times.append(time.time())
    finally:
        for one in (receiver, publisher):
            one.end()
    return times, publisher, receiver


def measured(frames: list[dict[str, Any]], begin: float, end: float) -> dict[str, Any]:
    """What was seen from `begin` to `end`. frames: lines of the receiver."""
    inside = [one for one in frames if begin <= one["at"] < end]
    shown = [(one["at"], one["at"] - one["latency_ms"] / 1e3) for one in frames if one["latency_ms"] is not None]
    ages, newest = [], 0
    made = [moment for _, moment in shown]
    for tick in range(int((end - begin) * 100)):
        now = begin + tick / 100
        while newest < len(shown) and shown[newest][0] <= now:
            newest += 1
        if newest:
            ages.append(1e3 * (now - max(made[max(newest - 5, 0) : newest])))
    rmse = [one["rmse_m"] for one in inside if one["rmse_m"] is not None]
    steps = [one["step"] or 1.0 for one in inside]
    late = [one["latency_ms"] for one in inside if one["latency_ms"] is not None]
    return {
        "latency_p50_ms": percentile(late, 0.5),
        "latency_p95_ms": percentile(late, 0.95),
        "fps": round(len(inside) / (end - begin), 1),
        "age_p50_ms": percentile(ages, 0.5),
        "age_p95_ms": percentile(ages, 0.95),
        "rmse_m": None if not rmse else round(sum(rmse) / len(rmse), 4),
        "worst_m": max((one["worst_m"] for one in inside if one["worst_m"] is not None), default=None),
        "column_step": percentile(steps, 0.5),
    }


def back_after_s(status: list[dict[str, Any]], times: list[float]) -> float | None:
    """Seconds after the link was restored until the target was at nine tenths of what it was before the cut."""
    told = [(one["at"], one["rate"]["target_kbps"]) for one in status if one.get("rate") and "at" in one]
    before = [target for at, target in told if times[0] + ADAPTING_S <= at < times[1]]
    restored = times[-2]
    if not before:
        return None
    wanted = BACK * sorted(before)[len(before) // 2]
    return next((round(at - restored, 1) for at, target in told if at >= restored and target >= wanted), None)


def rows(policy: str, times: list[float], publisher: End, receiver: End) -> list[dict[str, Any]]:
    """A row for each part of the run."""
    frames = [one for one in receiver.said if "index" in one]
    out = []
    for (kbit, _), begin, end in zip(PARTS, times, times[1:], strict=False):
        out.append({"policy": policy, "link_kbps": kbit, **measured(frames, begin + ADAPTING_S, end)})
        told = [one for one in publisher.said if one.get("rate") and begin + ADAPTING_S <= one.get("at", 0.0) < end]
        if told:
            out[-1]["target_kbps"] = percentile([one["rate"]["target_kbps"] for one in told], 0.5)
            found = [one["path"]["capacity_kbps"] for one in told if one["path"]["capacity_kbps"] is not None]
            out[-1]["capacity_kbps"] = percentile(found, 0.5)
    out[-1]["back_after_s"] = back_after_s(publisher.said, times)
    return out


def table(found: list[dict[str, Any]]) -> str:
    """The rows as a table."""
    text = "| policy | link, Mbit/s | latency p50 / p95, ms | frames/s | age p50 / p95, ms | RMSE, m "
    text += "| largest error, m | every n-th column | target, kbit/s | back after, s |\n"
    text += f"|{10 * '---|'}\n"
    for row in found:
        text += (
            f"| {row['policy']} | {row['link_kbps'] / 1e3:g} | {row['latency_p50_ms']} / {row['latency_p95_ms']} "
            f"| {row['fps']} | {row['age_p50_ms']} / {row['age_p95_ms']} | {row['rmse_m']} "
            f"| {row['worst_m']} | {row['column_step']} | {row.get('target_kbps', '')} "
            f"| {row.get('back_after_s') or ''} |\n"
        )
    return text


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.adaptive", description=__doc__.splitlines()[0])
    parser.add_argument("--link", choices=("namespaces", "relay"), default="namespaces")
    parser.add_argument("--source", default=str(SOURCE))
    parser.add_argument("--policy", action="append", choices=tuple(POLICIES), help="all by default")
    parser.add_argument("--delay-ms", type=float, default=0.0, help="each way; relay only")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--save", action="store_true")
    options = parser.parse_args()
    if options.link == "namespaces" and (why := Namespaces.missing()):
        print(why, file=sys.stderr)
        return 1
    found: list[dict[str, Any]] = []
    for policy in options.policy or POLICIES:
        link: Namespaces | Relayed
        if options.link == "namespaces":
            link = Namespaces(PARTS[0][0])
        else:
            link = Relayed(PARTS[0][0], free_port=free_port, delay_s=options.delay_ms / 1e3)
        with link:
            found += rows(policy, *play(link, policy, options.source))
    print(json.dumps(found, indent=2) if options.json else table(found), end="")
    if options.save:
        results.save(f"links/{options.link}", f"# {TITLES[options.link]}\n\n{ABOUT}\n\n{table(found)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
