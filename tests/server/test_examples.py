"""The examples in the server's modules run: they are what a reader believes first."""

import doctest
import importlib
import os
import pkgutil
from pathlib import Path

import pytest

import lidarcodec_server

MODULES = sorted(
    found.name
    for found in pkgutil.walk_packages(lidarcodec_server.__path__, "lidarcodec_server.")
    if ".migrations" not in found.name
)


def has_examples(name):
    """Whether there is an example in a module."""
    path = Path(lidarcodec_server.__file__).parent.joinpath(*name.split(".")[1:])
    return ">>>" in (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text()


def test_every_module_can_be_imported():
    for name in MODULES:
        importlib.import_module(name)


@pytest.mark.parametrize("name", [name for name in MODULES if has_examples(name)])
def test_the_examples_of_a_module_run(name, monkeypatch):
    for variable in [key for key in os.environ if key.startswith("LIDARCODEC_")]:
        monkeypatch.delenv(variable)
    assert doctest.testmod(importlib.import_module(name)).failed == 0
