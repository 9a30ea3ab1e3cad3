"""Processes that are started import nothing from the folder in which somebody happens to be."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = sorted([*(ROOT / "lidarcodec").rglob("*.py"), *(ROOT / "server" / "lidarcodec_server").rglob("*.py")])
HOSTILE = "import os, pathlib; pathlib.Path(os.environ['WITNESS']).write_text(__file__)\nraise SystemExit(66)\n"


def executables(tree):
    """Lists and tuples in which `sys.executable` stands, with the word behind it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.List | ast.Tuple):
            for number, word in enumerate(node.elts):
                if ast.unparse(word) == "sys.executable":
                    after = node.elts[number + 1] if number + 1 < len(node.elts) else None
                    yield node.lineno, getattr(after, "value", None)


def test_every_child_is_started_with_dash_P():
    found = 0
    for path in SHIPPED:
        text = path.read_text()
        if "sys.executable" not in text:
            continue
        words = list(executables(ast.parse(text)))
        assert text.count("sys.executable") == len(words), f"{path}: sys.executable outside of a list of words"
        for line, after in words:
            found += 1
            assert after == "-P", f"{path}:{line}"
    assert found >= 3


def test_a_demonstration_imports_nothing_from_a_hostile_folder(tmp_path):
    for name in ("numpy", "typing", "zenoh", "sqlite3", "lidarcodec"):
        (tmp_path / f"{name}.py").write_text(HOSTILE)
    witness = tmp_path.parent / f"{tmp_path.name}.witness"
    program = Path(sys.executable).with_name("lidarcodec")
    if not program.exists():
        pytest.skip("the command line is not installed")
    environment = os.environ | {"WITNESS": str(witness)}
    words = ["demo", "--no-browser", "--seconds", "2"]
    subprocess.run([program, *words], cwd=tmp_path, env=environment, capture_output=True, timeout=120, check=False)
    assert not witness.exists(), witness.read_text()
