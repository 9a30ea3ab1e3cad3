"""Processes that are started import nothing from the folder in which somebody happens to be."""

import ast
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = sorted([*(ROOT / "lidarcodec").rglob("*.py"), *(ROOT / "server" / "lidarcodec_server").rglob("*.py")])
SPAWNING = ("ProcessPoolExecutor", "get_context", "multiprocessing", "num_workers", "create_subprocess_exec")
OF_OS = ("exec", "spawn", "posix_spawn", "popen", "system")
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


def test_no_other_way_to_start_a_process_is_used_but_one_that_is_made_safe():
    """`multiprocessing` writes its own command lines: where it is used, PYTHONSAFEPATH is set for them."""
    found = {}
    for path in SHIPPED:
        text = path.read_text()
        if not any(word in text for word in (*SPAWNING, *OF_OS)):  # to parse all takes seconds
            continue
        for node in ast.walk(ast.parse(text)):
            name = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
            of_os = isinstance(node, ast.Attribute) and ast.unparse(node.value) == "os" and name.startswith(OF_OS)
            if name in SPAWNING or of_os:
                found.setdefault(path.relative_to(ROOT).as_posix(), []).append(node.lineno)
    safe = {
        "lidarcodec/training/annotate.py": "with safe_path(), ProcessPoolExecutor(",
        "lidarcodec/archive/dataset.py": "1 if worker is None else worker.num_workers",  # it starts none
    }
    assert set(found) == set(safe), found
    for name, words in safe.items():
        assert words in (ROOT / name).read_text()


@pytest.fixture
def hostile(tmp_path):
    """A folder of modules that leave a witness when they are imported."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name in ("numpy", "typing", "zenoh", "sqlite3", "lidarcodec", "multiprocessing", "pickle", "struct"):
        (folder / f"{name}.py").write_text(HOSTILE)
    return folder


def ran(words, folder):
    """What a process in a folder gave; no hostile module may have been imported, here or in what it starts."""
    witness = folder.with_name("witness")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    environment = os.environ | {"WITNESS": str(witness), "LIDARCODEC_LOOPBACK_PORT": port}
    environment.pop("PYTHONSAFEPATH", None)
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert not witness.exists(), witness.read_text()
    return done


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(["demo", "--no-browser", "--seconds", "2"], marks=pytest.mark.sweep),
        ["swarm", "2", "sim:road", "--frames", "1", "--processes", "2", "--seconds", "1"],
    ],
    ids=lambda words: words[0],
)
def test_a_command_imports_nothing_from_a_hostile_folder(hostile, words):
    program = Path(sys.executable).with_name("lidarcodec")
    if not program.exists():
        pytest.skip("the command line is not installed")
    done = ran([program, *words], hostile)
    assert done.returncode == 0, done.stderr


ANNOTATING = """
import os
from pathlib import Path
from lidarcodec.training.annotate import AnnotationSettings, _spread
from lidarcodec.training.annotation_folder import AnnotationFolder

def work(path, settings, first):
    (path / str(first)).touch()

if __name__ == "__main__":
    _spread(work, AnnotationFolder(Path(os.environ["OUT"])), AnnotationSettings("-"), [0, 1], 2, lambda: None)
"""


def test_what_annotation_spawns_imports_nothing_from_a_hostile_folder(hostile, tmp_path, monkeypatch):
    (tmp_path / "made").mkdir()
    (tmp_path / "annotating.py").write_text(ANNOTATING)
    monkeypatch.setenv("OUT", str(tmp_path / "made"))
    done = ran([sys.executable, tmp_path / "annotating.py"], hostile)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "made").iterdir()} == {"0", "1"}
