"""The table of long runs of damaged messages (`tests.fuzz.campaign`), by configuration and in all.

    python -m tests.fuzz.counts build/fuzz/campaign --write docs/robustness.md

Several folders are counted together: each core can have a run of its own, with a seed of its own. Other sensors than
the HDL-64E have tables of their own; tables of which the folders hold no case stay as they are.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from tests.fuzz.campaign import Counts
from tests.fuzz.corpus import Plan, plans

BEGIN, END = "<!-- messages: begin -->\n", "<!-- messages: end -->\n"
BEGIN_OTHERS, END_OTHERS = "<!-- other messages: begin -->\n", "<!-- other messages: end -->\n"
_SHORT = {
    "decoded": "decoded",
    "MissingReferenceError": "reference",
    "TruncatedError": "truncated",
    "SectionError": "section",
}
Chosen = list[tuple[Plan, Counts]]
_HEAD = ("configuration", "cases", "refer to another", *_SHORT.values(), "others", "slowest, ms", "memory, MiB")


def _line(cells: Iterable[object]) -> str:
    return f"| {' | '.join(map(str, cells))} |\n"


def _row(name: str, counts: Counts) -> str:
    of = counts.outcomes
    others = ", ".join(f"{kind} {n:,}" for kind, n in sorted(of.items()) if kind not in _SHORT)
    shown = [f"{of.get(kind, 0):,}" for kind in _SHORT]
    return _line(
        [name, f"{counts.cases:,}", f"{counts.inter:,}", *shown, others or 0, counts.slowest_ms, counts.jump_mib]
    )


def _joined(parts: Iterable[Counts]) -> Counts:
    whole = Counts()
    for part in parts:
        whole.join(part)
    return whole


_KINDS: dict[str, Callable[[Plan], bool]] = {
    "frames that follow": lambda plan: plan.follows,
    "ranges within a bound": lambda plan: plan.other and "max_error_m" in plan.settings,
    "free ranges": lambda plan: plan.free,
    "fewer columns": lambda plan: plan.thinned,
    "fewer returns": lambda plan: plan.reduced,
    "few intensities": lambda plan: plan.few,
    "a target bitrate": lambda plan: plan.aimed,
    "weights": lambda plan: plan.weights,
}


def _groups(chosen: Chosen) -> Iterable[tuple[str, Counts]]:
    """What a reader asks first: sizes, kinds, and all."""
    for size in dict.fromkeys(plan.size for plan, _ in chosen):
        yield f"**all of {size}**", _joined(counts for plan, counts in chosen if plan.size == size)
    for name, has in _KINDS.items():
        if any(has(plan) for plan, _ in chosen):
            yield f"**all with {name}**", _joined(counts for plan, counts in chosen if has(plan))
    yield "**all**", _joined(counts for _, counts in chosen)


def _by_name(chosen: Chosen) -> Iterable[tuple[str, Counts]]:
    """Configurations, each in all of its sizes."""
    for name in dict.fromkeys(plan.name for plan, _ in chosen):
        yield name, _joined(counts for plan, counts in chosen if plan.name == name)


def _read(states: Iterable[Path]) -> tuple[list[int], Chosen]:
    """Seeds of the runs in some folders, and their counts by configuration."""
    known = {f"{plan.name}, {plan.size}": plan for plan in plans()}
    seeds, found = [], {name: Counts() for name in known}
    for state in states:
        values = json.loads((state / "state.json").read_text())
        seeds.append(values["seed"])
        for name, counts in values["configurations"].items():
            if name in known:
                found[name].join(Counts(**counts))
    return seeds, [(known[name], counts) for name, counts in found.items() if counts.cases]


def tables(*states: Path, others: bool = False) -> str:
    """The tables of the runs in some folders, their cases together, and what broke a rule; empty without cases.

    others: those of other sensors than the HDL-64E
    """
    seeds, found_there = _read(states)
    chosen = [(plan, counts) for plan, counts in found_there if plan.other == others]
    if not chosen:
        return ""
    if len(set(seeds)) < len(seeds):
        raise SystemExit("two runs of one seed are the same cases: name runs of different seeds")
    head = _line(_HEAD) + _line(["---"] + ["---:"] * (len(_HEAD) - 1))
    found = [why for _, counts in chosen for why in counts.found]
    text = f"Seeds {' and '.join(map(str, seeds))}. " if len(seeds) > 1 else f"Seed {seeds[0]}. "
    text += "Slowest: time of the processor; memory: beyond what was held before.\n\n"
    text += head + "".join(_row(name, counts) for name, counts in _groups(chosen))
    text += "\nBy configuration, all sizes together:\n\n" + head + "".join(_row(*of) for of in _by_name(chosen))
    if not found:
        return f"{text}\nNothing broke a rule.\n"
    return f"{text}\nAgainst a rule:\n\n" + "".join(f"- {why}\n" for why in found)


def written(page: str, text: str, *, others: bool = False) -> str:
    """A page with its tables replaced, if there are others.

    Raises ValueError when the page has no place for them.
    """
    if not text:
        return page
    head, begin, rest = page.partition(BEGIN_OTHERS if others else BEGIN)
    _, end, tail = rest.partition(END_OTHERS if others else END)
    if not begin or not end:
        raise ValueError("the page has no place for the tables")
    return f"{head}{begin}\n{text}\n{end}{tail}"


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("states", type=Path, nargs="*", default=[Path("build/fuzz/campaign")], metavar="STATE")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    for others in (False, True):
        text = tables(*options.states, others=others)
        if options.write is None:
            print(text)
        else:
            options.write.write_text(written(options.write.read_text(), text, others=others))
    return 0


if __name__ == "__main__":
    sys.exit(main())
