"""A long run of damaged messages over all configurations, which can be stopped and goes on where it was.

    nice python -m tests.fuzz.campaign --cases 2000000 --seed 1 --state build/fuzz/campaign

Each configuration gets its share. Cases run in blocks, each in a child of its own, so that a crash costs one block and
is told with its signal. After each block the counts are written to the state's folder; SIGTERM and Ctrl-C stop the run
behind the block at hand. What breaks a rule is kept there too, with every message that led to it:

- an exception that is no error of `lidarcodec.errors`, or a process that ends by a signal
- a message that takes over a second of the processor, or 512 MiB more memory than before
- a valid message that is refused and refers to no other

`python -m tests.fuzz.counts` makes a table of the state.
"""

from __future__ import annotations

import argparse
import json
import logging
import mmap
import os
import resource
import signal
import struct
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from lidarcodec.codecs import table
from tests.fuzz.chains import Chain, Outcome
from tests.fuzz.corpus import Plan, Stream, plans, stream

SLOWEST_S = 1.0
LARGEST_MIB = 512
BLOCK_S = 2.0
"""Seconds of the processor after which a block ends, behind its chain."""
HUNG_S = 120
"""Seconds of the processor after which a child is killed."""
MEMORY_MIB = 4096
"""Address space that a child may take beyond what it began with."""
STOPS = (signal.SIGTERM, signal.SIGINT)


@dataclass
class Counts:
    """What came of the cases of one configuration.

    next: number of the chain that comes next; inter: cases whose message referred to another
    slowest_ms, jump_mib: of one case; refused: valid messages; found: what broke a rule
    """

    next: int = 0
    cases: int = 0
    inter: int = 0
    outcomes: dict[str, int] = field(default_factory=dict)
    slowest_ms: float = 0.0
    jump_mib: float = 0.0
    seconds: float = 0.0
    refused: int = 0
    found: list[str] = field(default_factory=list)

    def add(self, outcome: Outcome) -> None:
        """Count a case."""
        self.cases += 1
        self.inter += outcome.inter
        self.outcomes[outcome.kind] = self.outcomes.get(outcome.kind, 0) + 1
        self.slowest_ms = max(self.slowest_ms, round(outcome.seconds * 1e3, 1))
        self.jump_mib = max(self.jump_mib, round(outcome.jump_kib / 1024, 1))

    def join(self, other: Counts) -> None:
        """Add those of a block."""
        self.next = max(self.next, other.next)
        self.cases, self.inter = self.cases + other.cases, self.inter + other.inter
        self.outcomes = dict(Counter(self.outcomes) + Counter(other.outcomes))
        self.slowest_ms, self.jump_mib = max(self.slowest_ms, other.slowest_ms), max(self.jump_mib, other.jump_mib)
        self.seconds = round(self.seconds + other.seconds, 2)
        self.refused += other.refused
        self.found = self.found + other.found


def wrong_with(outcome: Outcome) -> str:
    """Which rule a case broke; empty if none."""
    if outcome.foreign:
        return outcome.foreign
    if outcome.seconds > SLOWEST_S:
        return f"{outcome.seconds:.2f} s for one message, {outcome.kind}"
    if outcome.jump_kib > LARGEST_MIB * 1024:
        return f"{outcome.jump_kib // 1024} MiB more for one message, {outcome.kind}"
    return ""


def block(
    given: Stream, seed: int, first: int, *, at: mmap.mmap | None, kept: Path, limit: int | None = None
) -> Counts:
    """The counts of chains from `first` on, for two seconds, or `limit` chains.

    at: where the chain's number is written; kept: the folder for what broke a rule
    """
    counts, began = Counts(next=first), time.process_time()
    while (counts.next - first < limit) if limit is not None else (time.process_time() - began < BLOCK_S):
        if at is not None:
            at[:8] = struct.pack("<q", counts.next)
        chain = Chain(given, counts.next, seed)
        for outcome in chain.run():
            counts.add(outcome)
            if wrong := wrong_with(outcome):
                counts.found.append(_keep(chain, wrong, kept))
        counts.refused += len(chain.refused)
        if chain.refused and not counts.found:
            counts.found.append(_keep(chain, f"a valid message was refused: {chain.refused[0]}", kept))
        counts.next += 1
    counts.seconds = time.process_time() - began
    return counts


def _keep(chain: Chain, wrong: str, kept: Path) -> str:
    """Write down every message that led to what broke a rule; one line about it."""
    folder = kept / f"{chain.stream.name}, {chain.stream.size}, chain {chain.number}".replace(" ", "_")
    folder.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(chain.history):
        (folder / f"{number:02}.ldc").write_bytes(data)
    (folder / "why.txt").write_text(f"{wrong}\n")
    return f"{folder.name}: {wrong}"


class Campaign:
    """The run. state: its folder; whatever is in it is gone on with."""

    def __init__(self, state: Path, seed: int, only: str = "", *, others: bool = False) -> None:
        self._folder, self._seed = state, seed
        chosen = {f"{plan.name}, {plan.size}": plan for plan in plans() if plan.other or not others}
        self.plans = {name: plan for name, plan in chosen.items() if only in name}
        self.counts: dict[str, Counts] = {name: Counts() for name in self.plans}
        self._stopped = False
        if (kept := state / "state.json").exists():
            before = json.loads(kept.read_text())
            if before["seed"] != seed:
                raise SystemExit(f"{state} holds a run of seed {before['seed']}: name another folder")
            self.counts |= {name: Counts(**values) for name, values in before["configurations"].items()}

    @property
    def total(self) -> int:
        """Cases so far."""
        return sum(counts.cases for counts in self.counts.values())

    def stop(self, _signal: int, _frame: FrameType | None) -> None:
        """Stop behind the block at hand."""
        self._stopped = True

    def run(self, cases: int) -> Iterator[str]:
        """Run until there are so many cases, or it is stopped; the configuration of each block that was done."""
        while not self._stopped and self.total < cases:
            name = min(self.plans, key=lambda name: self.counts[name].cases / self.plans[name].share)
            self.counts[name].join(self._block(self.plans[name], self.counts[name].next))
            self._write()
            yield name

    def _block(self, plan: Plan, first: int) -> Counts:
        at = mmap.mmap(-1, 8)
        at[:8] = struct.pack("<q", first)
        reads, writes = os.pipe()
        if (child := os.fork()) == 0:
            os.close(reads)
            _work(lambda: block(self._stream(plan), self._seed, first, at=at, kept=self._folder / "found"), writes)
        os.close(writes)
        with os.fdopen(reads, "rb") as pipe:
            data = pipe.read()
        status = os.waitpid(child, 0)[1]
        if data and os.waitstatus_to_exitcode(status) == 0:
            return Counts(**json.loads(data))
        (number,) = struct.unpack("<q", at[:8])
        why = _name_of(os.waitstatus_to_exitcode(status))
        return Counts(next=number + 1, found=[f"{plan.name}, {plan.size}, chain {number}: the process ended by {why}"])

    def _stream(self, plan: Plan) -> Stream:
        """A stream, made once: its messages are kept beside the state."""
        folder = self._folder / "corpus" / f"{plan.name}, {plan.size}".replace(" ", "_")
        if not (folder / "whole").exists():
            folder.mkdir(parents=True, exist_ok=True)
            made = stream(plan, self._seed)
            for number, data in enumerate(made.messages):
                (folder / f"{number:02}.ldc").write_bytes(data)
            (folder / "whole").touch()
            return made
        messages = tuple(path.read_bytes() for path in sorted(folder.glob("*.ldc")))
        return Stream.of(plan, messages)

    def _write(self) -> None:
        values: dict[str, Any] = {"seed": self._seed, "cases": self.total}
        values["configurations"] = {name: asdict(counts) for name, counts in self.counts.items()}
        beside = self._folder / "state.json.new"
        beside.write_text(json.dumps(values, indent=1))
        beside.replace(self._folder / "state.json")


def _work(make: Any, writes: int) -> None:
    """What a child does: work within limits, and tell the counts."""
    for stop in STOPS:
        signal.signal(stop, signal.SIG_IGN)  # the parent says when to stop
    size = int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY_MIB * 2**20,) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (HUNG_S, HUNG_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("error", RuntimeWarning)  # numpy's, which a viewer would see
    try:
        counts = make()
        with os.fdopen(writes, "w") as pipe:
            json.dump(asdict(counts), pipe)
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        os._exit(1)
    os._exit(0)


def _name_of(code: int) -> str:
    return f"exit code {code}" if code >= 0 else signal.Signals(-code).name


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=2_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--state", type=Path, default=Path("build/fuzz/campaign"))
    parser.add_argument("--only", default="", help="configurations whose name holds this")
    parser.add_argument("--others", action="store_true", help="only sensors beside the HDL-64E, and point clouds")
    options = parser.parse_args()
    logging.getLogger("lidarcodec").setLevel(logging.ERROR)  # what is wrong with each case is told in the counts
    options.state.mkdir(parents=True, exist_ok=True)
    for name in table.names():
        table.codec(name)  # imported before children are made
    campaign = Campaign(options.state, options.seed, options.only, others=options.others)
    for stop in STOPS:
        signal.signal(stop, campaign.stop)
    began, before, told = time.monotonic(), campaign.total, 0.0
    for _ in campaign.run(options.cases):
        if (now := time.monotonic()) - told > 10:
            told, done = now, campaign.total
            rate = (done - before) / (now - began)
            found = sum(len(counts.found) for counts in campaign.counts.values())
            print(f"{done} cases, {rate:.0f} a second, {found} against a rule", flush=True)
    print(f"{campaign.total} cases", flush=True)
    return 1 if any(counts.found for counts in campaign.counts.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
