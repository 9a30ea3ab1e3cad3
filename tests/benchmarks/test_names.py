"""Programs that are run by hand, and seldom, still know the names of what they use."""

import ast
import importlib

import pytest

from tests.conftest import ROOT

PROGRAMS = sorted(path for folder in ("benchmarks", "tools") for path in (ROOT / folder).glob("*.py"))


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_what_a_program_imports_of_us_is_there(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith(("lidarcodec", "benchmarks")):
            continue
        if node.module.startswith("benchmarks"):
            found = (ROOT / f"{node.module.replace('.', '/')}.py").read_text() if "." in node.module else ""
            for alias in node.names:
                assert (ROOT / "benchmarks" / f"{alias.name}.py").exists() or alias.name in found, alias.name
            continue
        try:
            module = importlib.import_module(node.module)
        except ModuleNotFoundError as error:
            if (error.name or "").startswith("lidarcodec"):
                raise
            pytest.skip(f"needs {error.name}")
        for alias in node.names:
            if not hasattr(module, alias.name):
                importlib.import_module(f"{node.module}.{alias.name}")
