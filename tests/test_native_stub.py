"""The types of the native core are those of the built module."""

from __future__ import annotations

import pytest

from tests.conftest import ROOT


def test_the_committed_types_are_those_of_the_module():
    pytest.importorskip("nanobind")
    pytest.importorskip("ruff")
    from tools.native_stub import stub

    committed = (ROOT / "lidarcodec" / "_native.pyi").read_text()
    assert committed == stub(), "run `make native`, and commit lidarcodec/_native.pyi"
