"""A small, seeded part of `make fuzz`: what a user would lose is a receiver that survives bad bytes."""

from __future__ import annotations

from pathlib import Path

from tests.fuzz.run import run, targets


def test_damage_gives_errors_of_the_project_and_nothing_else(tmp_path: Path) -> None:
    outcomes = run(cases=100 * len(targets()), seed=7, crash_dir=tmp_path)
    for name, counts in outcomes.items():
        assert counts.total() == 100, name
    assert sum(c["ChecksumError"] for c in outcomes.values()) > 0
    assert sum(c["SectionError"] for c in outcomes.values()) > 0
    assert outcomes["packets"] == {"decoded": 100}
