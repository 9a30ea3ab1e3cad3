"""Every wait has a limit: nothing in the live path may hang because somebody else does."""

from __future__ import annotations

import ast
import threading

import pytest

from lidarcodec.apps.ending import ended
from tests.conftest import ROOT

FOLDERS = ("lidarcodec/apps", "lidarcodec/transport", "lidarcodec/bridges")
FIRST_IS_LIMIT = {"wait", "join", "acquire", "get", "recv"}
NO_QUEUE = {"webbrowser"}
SECOND_IS_LIMIT = {"wait_for"}
FOR_WORK = {
    ("lidarcodec/apps/publisher/learning.py", "_allowed"),
    ("lidarcodec/apps/receiver/udp_out.py", "_run"),
    ("lidarcodec/apps/recorder.py", "_run"),
    ("lidarcodec/apps/publisher/refining.py", "_next"),
    ("lidarcodec/apps/receiver/refinements.py", "_run"),
    ("lidarcodec/apps/spot_check.py", "_run"),
    ("lidarcodec/transport/memory.py", "_run"),
    ("lidarcodec/transport/memory.py", "receive"),
    ("lidarcodec/transport/zenoh.py", "receive"),
}
"""Threads of our own that wait for work: `close` wakes them, and whoever closes waits for them with a limit."""
OURS = {
    ("lidarcodec/apps/publisher/publisher.py", "run"),  # Publisher.wait: until the source ends, looks every TICK_S
}


def unlimited(path) -> list[tuple[str, str, int]]:
    """Waits of a file without a limit: function and line."""
    found = []

    def look(node: ast.AST, function: str) -> None:
        for child in ast.iter_child_nodes(node):
            inside = child.name if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef) else function
            if isinstance(child, ast.Call) and isinstance(child.func, ast.Attribute) and not is_no_queue(child.func):
                name, given = child.func.attr, len(child.args) + len(child.keywords)
                if (name in FIRST_IS_LIMIT and given < 1) or (name in SECOND_IS_LIMIT and given < 2):
                    found.append((function, name, child.lineno))
            look(child, inside)

    look(ast.parse(path.read_text()), "")
    return found


def is_no_queue(called: ast.Attribute) -> bool:
    return isinstance(called.value, ast.Name) and called.value.id in NO_QUEUE


def test_every_wait_has_a_limit():
    left = []
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = str(path.relative_to(ROOT))
            for function, what, line in unlimited(path):
                if (name, function) not in FOR_WORK | OURS and not awaited_with_limit(path, line):
                    left.append(f"{name}:{line} {function}: {what}")
    assert not left, "give each a limit, or say here why it needs none:\n" + "\n".join(left)


def awaited_with_limit(path, line: int) -> bool:
    """`asyncio.wait_for(event.wait(), limit)`: the limit is around it."""
    return "asyncio.wait_for(" in path.read_text().splitlines()[line - 1]


def test_what_is_allowed_is_there():
    for name, function in FOR_WORK | OURS:
        assert function in {one[0] for one in unlimited(ROOT / name)}, (name, function)


def test_a_thread_that_hangs_is_left_behind_and_named(caplog):
    go = threading.Event()
    hangs = threading.Thread(target=go.wait, args=(60,), name="lidarcodec hangs", daemon=True)
    never = threading.Thread(target=go.wait, args=(60,), name="never begun")
    hangs.start()
    try:
        assert not ended([hangs, never], 0.1)
        assert "lidarcodec hangs" in caplog.text
        assert "never begun" not in caplog.text
    finally:
        go.set()
    assert ended([hangs], 10.0)


@pytest.mark.parametrize("name", ["apps", "transport"])
def test_the_folders_are_looked_at(name):
    assert len(list((ROOT / "lidarcodec" / name).rglob("*.py"))) > 5
