"""One row and one kind of failure: a child for each n, until a child runs in which nothing failed.

    python -m tests.failing.sweep ROW KIND [--at-most N]

is run with the shim in LD_PRELOAD, and prints a line of JSON. Of disks two: the n-th call fails, then all from it on.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from tests.failing import shim
from tests.failing.rows import Row, inputs, rows

_FAILURES = (0, 1)
"""Exit codes that may be: it went well all the same, or it failed and said so."""


def attempt(row: Row, folder: Path, kind: shim.Kind, number: int, *, goes_on: bool) -> tuple[int, int, list[str]]:
    """Exit code of one child, calls that it made, and what is wrong. number: of the call that fails, 0 for none."""
    out = Path(tempfile.mkdtemp(dir=folder))
    row.before(out)
    calls = folder / "calls"
    said = folder / "stderr"
    calls.unlink(missing_ok=True)  # before the child may write it
    if (child := os.fork()) == 0:
        handle = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(handle, 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        shim.arm(kind, number, goes_on=goes_on)
        try:
            code = row.work(out)
        except BaseException as error:  # nothing may come here
            shim.disarm()
            sys.stderr.write(f"{type(error).__name__}: {error}\n")
            code = 99
        count = shim.disarm()
        sys.stderr.flush()
        calls.write_text(str(count))
        os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    wrong = row.check(out, code)
    text = said.read_text()
    lines = [line for line in text.splitlines() if line]
    if code not in _FAILURES:
        wrong.append(f"exit code {code}: {text[-300:]}")
    if "Traceback" in text or "unexpected" in text:
        wrong.append(f"it said: {text[-300:]}")
    if code == 1 and not lines:
        wrong.append("it failed without a word")
    shutil.rmtree(out)
    return code, int(calls.read_text()) if calls.exists() else -1, wrong


def sweep(row: Row, kind: shim.Kind, *, goes_on: bool, at_most: int, seed: int = 1) -> dict[str, Any]:
    """Calls, tries, exit codes and what was wrong of a row. at_most: so many n at random instead of every one."""
    with tempfile.TemporaryDirectory(prefix="lidarcodec-failing-") as name:
        folder = Path(name) / "in"
        folder.mkdir()
        inputs(folder)
        work = Path(name)
        row.work(Path(tempfile.mkdtemp(dir=work)))  # what is imported late is there from now on
        _, total, wrong = attempt(row, work, kind, 0, goes_on=False)
        codes: Counter[int] = Counter()
        found = [f"nothing failed: {one}" for one in wrong]
        numbers = list(range(1, total + 1))
        if len(numbers) > at_most:
            numbers = [*sorted(random.Random(seed).sample(numbers, at_most - 1)), total]
        for number in numbers:
            code, _, wrong = attempt(row, work, kind, number, goes_on=goes_on)
            codes[code] += 1
            found += [f"n={number}: {one}" for one in wrong]
    return {"row": row.name, "kind": kind.name.lower(), "goes_on": goes_on, "calls": total, "tries": len(numbers),
            "codes": dict(codes), "wrong": found}  # fmt: skip


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.failing.sweep")
    parser.add_argument("row")
    parser.add_argument("kind", choices=[kind.name.lower() for kind in shim.Kind])
    parser.add_argument("--at-most", type=int, default=1_000_000)
    given = parser.parse_args()
    (row,) = (row for row in rows() if row.name == given.row)
    kind = shim.Kind[given.kind.upper()]
    for goes_on in (False, True) if kind == shim.Kind.DISK else (False,):
        print(json.dumps(sweep(row, kind, goes_on=goes_on, at_most=given.at_most)), flush=True)
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)
