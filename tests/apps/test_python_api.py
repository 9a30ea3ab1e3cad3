"""The examples in docs/python-api.md, as a reader would run them: each block in an interpreter of its own state."""

from __future__ import annotations

import re

import pytest

from lidarcodec.settings import StreamSettings
from tests.conftest import ROOT
from tests.transport.conftest import free_port

TEXT = (ROOT / "docs" / "python-api.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_the_example_runs(number, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LIDARCODEC_LOOPBACK_PORT", str(free_port()))
    code = EXAMPLES[number]
    exec(compile(code, f"docs/python-api.md, example {number + 1}", "exec"), {"__name__": "__main__"})
    assert "print" not in code or capsys.readouterr().out


def test_every_setting_is_documented():
    section = TEXT[TEXT.index("## Settings") : TEXT.index("## Errors")]
    for name in StreamSettings.model_fields:
        assert f"`{name}`" in section
