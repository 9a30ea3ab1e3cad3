"""A thousand hostile requests at a running server, made from its OpenAPI document and by hand."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.command_line import ROOT, environment
from tests.faults.outcome import Outcome

CASES, LIMIT_S = 1000, 300


def run(cases: int = CASES) -> Outcome:
    command = [sys.executable, "-m", "tests.server.hostile", "--cases", str(cases)]
    done = subprocess.run(
        command, cwd=ROOT, env=environment(), capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    wrong = [] if done.returncode == 0 else [f"exit code {done.returncode}: {done.stderr.strip()[-300:]}"]
    told = json.loads(done.stdout.splitlines()[-1]) if not wrong else {"requests": 0, "statuses": {}}
    statuses = ", ".join(f"{count} with {status}" for status, count in told["statuses"].items())
    return Outcome(
        f"{told['requests']:,} hostile REST requests, made from the OpenAPI document and by hand",
        None,
        "nothing",
        f"client: each was answered as the document says: {statuses}",
        {},
        wrong,
    )
