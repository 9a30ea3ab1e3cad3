"""Delay of bases with and without refinements beside them, on slow links (`base_error_m`).

    python -m benchmarks.layers [--seconds 20] [--rounds 3] [--link NAME]... [--save]

Drive KITTI 0005 over a relay on loopback, publisher and receiver as processes. For --seconds the receiver takes bases
alone, then refinements, and so on by turns; the first seconds of each part do not count. The delay is the time from put
to arrival report. --save writes benchmarks/results/layers.csv, from which `make evidence` writes the table.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any, Final, NamedTuple

import lidarcodec
from benchmarks import results
from benchmarks.adaptive import End, percentile
from benchmarks.link_ends import KEYS
from benchmarks.links import Relayed
from benchmarks.scenes import DATA
from lidarcodec.transport.endpoints import free_port

WARM_UP_S: Final = 3.0
"""At the start of a part: the receiver connects again."""
CODEC: Final = "predictive"
TITLE: Final = "Base and refinements on slow links"
ABOUT: Final = (
    "Delay from put to arrival report of a base alone, and with refinements beside it, KITTI 0005, `predictive`, "
    "`intensity=off`, ranges exact after refinement. The base has a bound of 5 cm, of 20 cm at 2 Mbit/s."
)
HEAD: Final = (
    "| link | base alone, p50 / p95 ms | beside refinements, p50 / p95 ms | p95 longer | link used, alone / beside "
    "| sectors of 12 refined |\n|---|---|---|---|---|---|"
)


class Setup(NamedTuple):
    """A link, and a base that takes about half of it."""

    kbit: float
    round_trip_ms: float
    base_error_m: float


SETUPS: Final = {
    "2": Setup(2_000.0, 0.0, 0.2),
    "4": Setup(4_000.0, 0.0, 0.05),
    "12": Setup(12_000.0, 0.0, 0.05),
    "4+50ms": Setup(4_000.0, 50.0, 0.05),
}


class Part(NamedTuple):
    """What happened from `begin_s` to `end_s`, host times. carried: bytes over the link"""

    begin_s: float
    end_s: float
    carried: int


def played(setup: Setup, seconds: float, rounds: int) -> tuple[list[Part], list[dict[str, Any]]]:
    """Parts by turns, alone first, and what the publisher said."""
    settings = {"codec": CODEC, "intensity": "off", "base_error_m": setup.base_error_m}
    source = str(DATA / "kitti_0005.pcap.xz")
    parts: list[Part] = []
    with Relayed(setup.kbit, free_port=free_port, delay_s=setup.round_trip_ms / 2e3) as link:
        publisher = End(
            link, "publish", "publisher", policy="auto", source=source, listen=link.listen, settings=settings
        )
        try:
            publisher.wait("at")
            for number in range(2 * rounds):
                with lidarcodec.subscribe(KEYS.prefix, connect=link.connect, refine=number % 2 == 1) as live:
                    parts.append(_part(link, live, seconds))
        finally:
            publisher.end()
    return parts, publisher.said


def _part(link: Relayed, live: lidarcodec.LiveStream, seconds: float) -> Part:
    """Take frames for so long, once they come."""
    while live.next(1.0) is None:
        pass
    end_s = time.monotonic() + WARM_UP_S
    begun: tuple[float, int] | None = None
    while begun is None or time.monotonic() < end_s:
        live.next(0.2)
        if begun is None and time.monotonic() >= end_s:
            begun, end_s = (time.time(), link.carried), end_s + seconds
    return Part(begun[0], time.time(), link.carried - begun[1])


def row(name: str, parts: list[Part], said: list[dict[str, Any]]) -> str:
    """A line of the table."""
    setup = SETUPS[name]
    delays: tuple[list[float], list[float]] = ([], [])
    used, sectors, frames = [0.0, 0.0], 0, 0
    for number, part in enumerate(parts):
        inside = [one for one in said if part.begin_s < one.get("at", 0.0) < part.end_s]
        delays[number % 2].extend(ms for one in inside for ms in one["arrive_ms"])
        used[number % 2] += part.carried / ((part.end_s - part.begin_s) * setup.kbit * 125.0) / (len(parts) / 2)
        if number % 2:
            first, last = (inside[at]["refinements"] for at in (0, -1))
            sectors += last["arrived"] - first["arrived"]
            frames += last["frames"] - first["frames"]
    (alone_50, alone_95), (beside_50, beside_95) = (
        [percentile(values, q) or 0.0 for q in (0.5, 0.95)] for values in delays
    )
    trip = f", round trip {setup.round_trip_ms:g} ms" if setup.round_trip_ms else ""
    return (
        f"| {setup.kbit / 1e3:g} Mbit/s{trip} | {alone_50:.0f} / {alone_95:.0f} | {beside_50:.0f} / {beside_95:.0f} "
        f"| {beside_95 / alone_95 - 1.0:+.0%} | {used[0]:.0%} / {used[1]:.0%} | {sectors / max(frames, 1):.1f} |"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.layers", description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each part")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--link", action="append", choices=tuple(SETUPS), help="all by default")
    parser.add_argument("--save", action="store_true")
    options = parser.parse_args()
    lines = [HEAD]
    for name in options.link or SETUPS:
        lines.append(row(name, *played(SETUPS[name], options.seconds, options.rounds)))
        print(lines[-1], file=sys.stderr, flush=True)
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if options.save:
        results.save("layers", f"# {TITLE}\n\n{ABOUT}\n\n{text}")


if __name__ == "__main__":
    main()
