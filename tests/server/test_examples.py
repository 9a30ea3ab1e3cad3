"""The examples in the server's modules run: they are what a reader believes first."""

import doctest
import importlib
import os
import pkgutil

import pytest

import lidarcodec_server

MODULES = sorted(
    found.name
    for found in pkgutil.walk_packages(lidarcodec_server.__path__, "lidarcodec_server.")
    if ".migrations" not in found.name
)


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name, monkeypatch):
    for variable in [key for key in os.environ if key.startswith("LIDARCODEC_")]:
        monkeypatch.delenv(variable)
    assert doctest.testmod(importlib.import_module(name)).failed == 0
