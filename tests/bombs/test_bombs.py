"""Files that are made to be dear stay within the budget of their kind: memory, processor time, no temporary disk."""

import ast
import fcntl
import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from lidarcodec.budgets import BUDGETS
from tests.bombs.files import BOMBS
from tests.sweeps import sampled

pytestmark = pytest.mark.timeout(400)  # longer than the one process that opens all may take
ROOT = Path(__file__).resolve().parents[2]
UNTESTED = {} if find_spec("torch") else {"checkpoint": "torch is not installed: nothing reads one"}
OWN_FILES = {
    "lidarcodec/sensors/generic.py": "tables of the package",
    "lidarcodec/reduction/score_network.py": "weights of the package",
    "lidarcodec/ratecontrol/curve.py": "figures of the package",
    "lidarcodec/ratecontrol/image_curve.py": "figures of the package",
    "lidarcodec/commands/doctor/about.py": "/proc",
    "lidarcodec/archive/engines/worker.py": "/proc",
    "lidarcodec/transport/late_threads.py": "/proc",
    "lidarcodec/apps/health.py": "/proc",
    "lidarcodec/commands/join/captures.py": "as long as what it is compared with",
    "server/lidarcodec_server/routes/page.py": "the page of the package",
    "server/lidarcodec_server/web_files.py": "the page of the package",
}
"""Files whose `read_bytes` or `read_text` reads nothing that others wrote, and what it reads."""


DEAR = (
    *("mcap, records", "rosbag1, empty records", "checkpoint, bytes by a number"),
    *("compressed, empty records", "compressed, empty blocks", "map, many points"),
)
"""More than half of the time of all, each beside another one of its kind."""


@pytest.fixture(scope="module")
def results(request, tmp_path_factory):
    """What became of each file. One process opens all of them, for all processes of `pytest -n`."""
    base = tmp_path_factory.getbasetemp()
    folder = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    told = folder / "bombs.jsonl"
    with (folder / "bombs.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not told.exists():
            here = [item for item in request.session.items if item.path == request.path and hasattr(item, "callspec")]
            told.write_text(opened([item.callspec.params["name"] for item in here], tmp_path_factory.mktemp("bombs")))
    return {found["name"]: found for found in map(json.loads, told.read_text().splitlines())}


def opened(names, folder):
    """A line for each of these files."""
    command = [sys.executable, "-P", "-m", "tests.bombs.run", str(folder), *names]
    environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("name", sampled(BOMBS, [name for name in BOMBS if name not in DEAR]))
def test_a_bomb_is_refused_within_its_budget(results, name):
    found = results[name]
    budget = BUDGETS[found["kind"]]
    assert found["outcome"].partition(":")[0].endswith("Error"), found
    assert not found["outcome"].startswith(("foreign", "ended")), found
    assert found["cpu_s"] <= budget.cpu_s, found
    assert found["memory_mib"] <= budget.memory_mib, found


def test_every_kind_of_file_has_a_bomb_or_a_reason():
    assert {kind for name, (kind, _, _) in BOMBS.items() if name not in DEAR} | set(UNTESTED) == set(BUDGETS)


def test_the_documentation_states_the_budgets():
    text = (ROOT / "docs" / "robustness.md").read_text()
    for budget in BUDGETS.values():
        size = "any" if budget.size_mib is None else f"{budget.size_mib:g} MiB" if budget.size_mib >= 1 else "4 KiB"
        assert f"| {budget.files} | {size} | {budget.memory_mib} MiB | {budget.cpu_s} s | none |" in text


def test_no_file_is_read_whole_without_a_budget():
    found = set()
    for path in (*ROOT.glob("lidarcodec/**/*.py"), *ROOT.glob("server/lidarcodec_server/**/*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if "read_bytes" in text or "read_text" in text else ():
            if isinstance(node, ast.Attribute) and node.attr in ("read_bytes", "read_text"):
                found.add(path.relative_to(ROOT).as_posix())
    assert found == set(OWN_FILES)
