"""A small, seeded part of `make fuzz`: what a user would lose is a receiver that survives bad bytes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lidarcodec.errors import LidarCodecError
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamDecoder
from tests.fuzz import native_seeds
from tests.fuzz.campaign import Campaign, block
from tests.fuzz.corpus import plans, stream
from tests.fuzz.counts import BEGIN, END, tables, written
from tests.fuzz.run import QUICK, run, run_sealed, targets

ALL = {f"{plan.name}, {plan.size}": plan for plan in plans()}


def test_damage_gives_errors_of_the_project_and_nothing_else(tmp_path: Path) -> None:
    outcomes = run(cases=100 * len(targets()), seed=7, crash_dir=tmp_path)
    for name, counts in outcomes.items():
        assert counts.total() == 100, name
    assert sum(c["ChecksumError"] for c in outcomes.values()) > 0
    assert outcomes["packets"] == {"decoded": 100}


def test_damage_with_right_checksums_gives_errors_of_the_project_and_nothing_else(tmp_path: Path) -> None:
    outcomes = run_sealed(cases=600, seed=7, kept=tmp_path, sizes=QUICK)
    assert len(outcomes) > 50
    together = {kind for counts in outcomes.values() for kind in counts}
    assert together >= {"decoded", "SectionError", "TruncatedError", "MissingReferenceError"}


@pytest.mark.parametrize("name", [name for name, plan in ALL.items() if plan.size in (*QUICK, "still", "slab")])
def test_the_corpus_is_valid_and_the_same_for_a_seed(name: str) -> None:
    made, decoder = stream(ALL[name], 1), StreamDecoder()
    assert made.messages == stream(ALL[name], 1).messages
    frames = [frame for message in made.parts for frame in decoder.decode(message)]
    assert len(frames) == sum(message.frame_count for message in made.parts)


def test_the_corpus_has_what_its_configurations_say() -> None:
    def kinds(name: str) -> set[int]:
        return {section.type for message in stream(ALL[name], 1).parts for section in message.sections}

    assert SectionType.KEEP in kinds("riddle columns, slab")
    assert SectionType.WEIGHTS in kinds("riddle own weights, tiny")
    assert SectionType.MOTION in kinds("riddle, slab")
    assert SectionType.POSE in kinds("raw, extremes")
    updates = stream(ALL["riddle updates, tiny"], 1).parts
    assert [m.has(SectionType.WEIGHTS) for m in updates] == [False, True, False, False, True]
    assert any(m.needs is not None for m in stream(ALL["h264, tiny"], 1).parts)


@pytest.mark.parametrize("harness", native_seeds.HARNESSES)
def test_every_native_harness_has_seeds(harness: str) -> None:
    assert (Path(__file__).parents[2] / "native" / "fuzz" / f"{harness}.cpp").is_file()
    assert len(native_seeds.seeds(harness, 1)) >= 10


def test_no_native_harness_is_without_seeds() -> None:
    folder = Path(__file__).parents[2] / "native" / "fuzz"
    assert {path.stem for path in folder.glob("fuzz_*.cpp")} == set(native_seeds.HARNESSES)


def test_a_campaign_goes_on_where_it_was_and_makes_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.fuzz.campaign.BLOCK_S", 0.1)
    campaign = Campaign(tmp_path, 3, only="zstd, tiny")
    assert list(campaign.run(1)) == ["zstd, tiny"]
    again = Campaign(tmp_path, 3, only="zstd, tiny")
    assert again.total == campaign.total > 0
    assert again.counts["zstd, tiny"].next == campaign.counts["zstd, tiny"].next
    assert json.loads((tmp_path / "state.json").read_text())["cases"] == campaign.total
    page = written(f"before\n{BEGIN}old\n{END}after\n", tables(tmp_path))
    assert "| zstd, tiny |" in page
    assert "old" not in page
    assert page.endswith("after\n")


def test_what_breaks_a_rule_is_kept_with_all_that_led_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A test of the test: a decoder that raises what it must not is found, with the messages that show it."""
    made, decode = stream(ALL["zstd, tiny"], 1), StreamDecoder.decode

    def wrong(decoder: StreamDecoder, message: object) -> object:
        try:
            return decode(decoder, message)  # type: ignore[arg-type]
        except LidarCodecError as error:
            raise ValueError("of another kind") from error

    monkeypatch.setattr(StreamDecoder, "decode", wrong)
    counts = block(made, 1, 0, at=None, kept=tmp_path, limit=3)
    assert len(counts.found) == 3
    assert all("ValueError: of another kind" in found for found in counts.found)
    assert len(list(tmp_path.rglob("*.ldc"))) >= 3
