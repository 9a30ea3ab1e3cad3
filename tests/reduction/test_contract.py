"""Every reducer of the table under the contract: a new line there is tested without writing a test."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import lidarcodec.reduction
from lidarcodec.reduction import names, reduction
from tests.contracts import reducer

CHECKS = [
    reducer.check_budget,
    reducer.check_repeatable,
    reducer.check_reduced_before,
    reducer.check_ties,
    reducer.check_standing,
]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", names())
def test_contract(name: str, check) -> None:
    check(name)


def test_every_reducer_file_is_in_the_table() -> None:
    folder = Path(lidarcodec.reduction.__file__).parent
    files = {path.stem for path in folder.glob("*.py") if re.search(r"^REDUCTION = ", path.read_text(), re.M)}
    named = {reduction(name).make.__module__.rpartition(".")[2] for name in names()}
    assert files - named == set(), "files with a REDUCTION that reduction/table.py does not name"
    assert named == files
