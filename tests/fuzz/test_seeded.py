"""A small, seeded part of `make fuzz`: what a user would lose is a receiver that survives bad bytes."""

from __future__ import annotations

import contextlib
import json
import random
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from lidarcodec.codecs import table
from lidarcodec.entropy import decode_positions
from lidarcodec.entropy.rest_coder import decode_rest
from lidarcodec.errors import LidarCodecError
from lidarcodec.message import Message, SectionType
from lidarcodec.pipeline import StreamDecoder
from lidarcodec.planes.clouds.section import decode_cloud
from lidarcodec.planes.lattice_section import read_lattice
from lidarcodec.planes.plane_section import decode_plane_section
from lidarcodec.wire import unpack
from tests.fuzz import native_seeds
from tests.fuzz.campaign import Campaign, block
from tests.fuzz.chains import needed
from tests.fuzz.corpus import plans, stream
from tests.fuzz.counts import BEGIN, BEGIN_OTHERS, END, END_OTHERS, tables, written
from tests.fuzz.damage import damaged
from tests.fuzz.inside import damaged_lattice, damaged_positions
from tests.fuzz.inside_others import damaged_cloud, damaged_description, damaged_planes, damaged_rest
from tests.fuzz.run import QUICK, run, run_sealed, targets
from tests.sweeps import examples, sampled

ALL = {f"{plan.name}, {plan.size}": plan for plan in plans()}


@pytest.mark.hypothesis
def test_damage_gives_errors_of_the_project_and_nothing_else(tmp_path: Path) -> None:
    each, todo = examples(100), targets()
    outcomes = run(cases=each * len(todo), seed=7, crash_dir=tmp_path, todo=todo)
    for name, counts in outcomes.items():
        assert counts.total() == each, name
    assert sum(c["ChecksumError"] for c in outcomes.values()) > 0
    assert outcomes["packets"] == {"decoded": each}


@pytest.mark.parametrize("size", sampled((*QUICK, "vlp16", "os0-16", "clouds"), ["tiny"]))
def test_damage_with_right_checksums_gives_errors_of_the_project_and_nothing_else(tmp_path: Path, size: str) -> None:
    outcomes = run_sealed(cases=300, seed=7, kept=tmp_path, sizes=(size,))
    assert len(outcomes) > (25 if size in QUICK else 5)
    together = {kind for counts in outcomes.values() for kind in counts}
    assert together >= {"decoded", "SectionError", "TruncatedError", "MissingReferenceError"}


@pytest.mark.parametrize(
    "name",
    sampled(
        [name for name, plan in ALL.items() if plan.other or plan.size in (*QUICK, "still", "slab", "positions")],
        [
            name
            for name, plan in ALL.items()
            if plan.size in ("tiny", "still") or (plan.size == "xt32" and plan.name == plan.settings["codec"])
        ],
    ),
)
def test_the_corpus_is_valid_and_the_same_for_a_seed(name: str) -> None:
    made, decoder = stream(ALL[name], 1), StreamDecoder()
    assert made.messages == stream(ALL[name], 1).messages
    frames = [frame for message in made.parts for frame in decoder.decode(message)]
    assert len(frames) == sum(message.frame_count for message in made.parts)


@pytest.mark.sweep
def test_the_corpus_has_what_its_configurations_say() -> None:
    def kinds(name: str) -> set[int]:
        return {section.type for message in stream(ALL[name], 1).parts for section in message.sections}

    assert SectionType.KEEP in kinds("riddle columns, slab")
    assert SectionType.WEIGHTS in kinds("riddle own weights, tiny")
    assert SectionType.MOTION in kinds("riddle, slab")
    assert SectionType.POSE in kinds("raw, extremes")
    assert SectionType.POSITION in kinds("h264, positions")
    thinned = [plan for plan in plans() if plan.thinned]
    assert {plan.settings["codec"] for plan in thinned} == set(table.names())
    for plan in thinned:
        if plan.size == "slab":
            assert all(message.has(SectionType.LATTICE) for message in stream(plan, 1).parts), plan.name
    assert SectionType.LATTICE in kinds("riddle look, full-size")
    assert SectionType.KEEP in kinds("pcodec localise, full-size")
    updates = stream(ALL["riddle updates, tiny"], 1).parts
    assert [m.has(SectionType.WEIGHTS) for m in updates] == [False, True, False, False, True]
    assert any(m.needs is not None for m in stream(ALL["h264, tiny"], 1).parts)
    assert all(SectionType.LATTICE in kinds(f"{codec} lattice, vlp16") for codec in ("raw", "predictive", "riddle"))
    assert {SectionType.PLANES, SectionType.REST, SectionType.POSE, SectionType.POSITION} <= kinds("riddle, os0-16")
    assert SectionType.CLOUD in kinds("riddle, clouds")
    follows = stream(ALL["riddle, vlp16"], 1).parts
    assert sum(m.needs is not None for m in follows) > len(follows) / 2


def first_bytes(kind: SectionType, *names: str) -> set[int]:
    """What the sections of a type begin with, in streams of some configurations; ranges behind their step."""
    sections = [section for name in names for message in stream(ALL[name], 1).parts for section in message.sections]
    at = 2 if kind == SectionType.RANGE else 0
    return {section.data[at] for section in sections if section.type == kind and len(section.data) > at}


@pytest.mark.sweep
def test_the_corpus_has_free_and_rounded_ranges_of_every_kind() -> None:
    """docs/wire-format-predictive.md: kinds of whole frames and slabs, quick or not, with something expected or not."""
    predictive = [
        name
        for name, plan in ALL.items()
        if plan.settings["codec"] == "predictive" and plan.size in ("tiny", "full-size")
    ]
    without_network = {kind for kind in range(32) if not kind & 4}
    assert first_bytes(SectionType.RANGE, *predictive) == without_network


def test_the_corpus_has_few_intensities_and_lattices_of_every_form() -> None:
    assert first_bytes(SectionType.INTENSITY, "zstd levels, slab", "zstd error, slab") == {2}
    assert first_bytes(SectionType.INTENSITY, "pcodec levels, slab", "png error, slab") == {5}
    assert first_bytes(SectionType.LATTICE, "raw lattice, extremes") == {0, 1}
    assert first_bytes(SectionType.POSITION, "raw, positions", "raw, extremes") == {0, 1}


Damage = Callable[[bytes, Message], bytes]


def with_calibration(message: Message, data: bytes) -> Message:
    """The message with other bytes in its CALIBRATION section."""
    sections = (one._replace(data=data) if one.type == SectionType.CALIBRATION else one for one in message.sections)
    return replace(message, sections=tuple(sections))


def outcome(read: Callable[[bytes], object], data: bytes) -> str:
    """What came of a section: `read`, or what is said to be wrong with it, without its numbers."""
    try:
        read(data)
    except LidarCodecError as error:
        return re.sub(r"[0-9]+", "N", str(error))
    return "read"


@pytest.mark.sweep
def test_damage_is_inside_of_what_lattices_and_positions_pack() -> None:
    rng, lattices, positions = random.Random(5), set(), set()
    for message in (*stream(ALL["raw lattice, extremes"], 1).parts, *stream(ALL["raw lattice, positions"], 1).parts):
        if message.has(SectionType.LATTICE):
            data = message.section(SectionType.LATTICE)
            lattices |= {outcome(read_lattice, damaged_lattice(data, rng)) for _ in range(60)}
    for message in stream(ALL["raw, positions"], 1).parts:
        if message.has(SectionType.POSITION):
            data = message.section(SectionType.POSITION)
            for _ in range(60):
                positions.add(outcome(lambda given: decode_positions(given, 2), damaged_positions(data, rng)))
    data = stream(ALL["raw lattice, positions"], 1).parts[0].section(SectionType.LATTICE)
    for _ in range(2000):  # what is damaged already, too: the first of two wounds may leave any numbers
        data = damaged_lattice(data, rng)
    assert lattices >= {
        "read",
        "a lattice section with columns beyond the N of its frame, or twice",
        "a lattice of every N. column from N on",
        "side information of N columns in a lattice of N",
    }
    assert positions >= {
        "read",
        "a position section with packets of impossible sizes",
        "a position packet more than N years from its frame",
        "differences of position packets that are not of one size",
    }


@pytest.mark.sweep
def test_damage_is_inside_of_what_messages_of_other_sensors_pack() -> None:
    rng = random.Random(5)

    def outcomes(name: str, kind: SectionType, read: Callable[[bytes, Message], object], hurt: Damage) -> set[str]:
        messages = [message for message in stream(ALL[name], 1).parts if message.has(kind)]
        cases = [(message, hurt(message.section(kind), message)) for message in messages for _ in range(12)]
        return {outcome(lambda given, of=message: read(given, of), data) for message, data in cases}

    planes = outcomes(
        "zstd, vlp16",
        SectionType.PLANES,
        lambda data, message: decode_plane_section(data, message.width),
        lambda data, _: damaged_planes(data, rng),
    )
    rests = outcomes(
        "zstd, vlp16",
        SectionType.REST,
        lambda data, message: decode_rest(data, message.packets),
        lambda data, message: damaged_rest(data, message.packets, rng),
    )
    clouds = outcomes(
        "zstd, clouds",
        SectionType.CLOUD,
        lambda data, _: decode_cloud(data),
        lambda data, _: damaged_cloud(data, rng),
    )
    assert planes >= {"read", "a plane of unknown role N, or of N bits"}
    assert rests >= {"read", "a range coded stream ends too early"}
    assert clouds >= {"read", "the header of a cloud is not valid, or does not fit its points"}
    first = stream(ALL["raw, os0-16"], 1).parts[0]
    hurt = [damaged_description(first.section(SectionType.CALIBRATION), rng) for _ in range(60)]
    sensors = {outcome(lambda given: StreamDecoder().decode(with_calibration(first, given)), data) for data in hurt}
    assert sensors >= {"read", "calibration of unknown convention N, range step N or N rows"}
    assert any(said.startswith("a sensor whose description cannot be used") for said in sensors)


@pytest.mark.parametrize("name", ["riddle free, tiny", "predictive free motion, tiny", "predictive rounded, tiny"])
def test_damage_makes_free_ranges_of_rounded_ones_and_rounded_ones_of_free_ones(name: str) -> None:
    made, rng = stream(ALL[name], 1), random.Random(5)
    kinds, at = set(), 11 if "riddle" in name else 2
    for _ in range(2000):
        with contextlib.suppress(LidarCodecError):  # the header may be damaged, too
            sections = unpack(damaged(made.parts[1], made.parts[0].sections, rng)).sections
            kinds |= {s.data[at] for s in sections if s.type == SectionType.RANGE and len(s.data) > at}
    kind = made.parts[1].section(SectionType.RANGE)[at]
    assert kinds >= {kind, kind + (4 if "rounded" in name else -4)}


@pytest.mark.parametrize("name", ["riddle, extremes", "h264, extremes", "raw, extremes"])
def test_a_decoder_can_be_led_to_any_message_of_a_stream(name: str) -> None:
    parts = stream(ALL[name], 1).parts
    for at, message in enumerate(parts):
        decoder = StreamDecoder()
        for before in needed(parts, at):
            decoder.decode(parts[before])
        assert decoder.decode(message)


@pytest.mark.parametrize(
    "harness", sampled(native_seeds.HARNESSES, [one for one in native_seeds.HARNESSES if one != "fuzz_others"])
)
def test_every_native_harness_has_seeds(harness: str) -> None:
    assert (Path(__file__).parents[2] / "native" / "fuzz" / f"{harness}.cpp").is_file()
    assert len(native_seeds.seeds(harness, 1)) >= 10


def test_no_native_harness_is_without_seeds() -> None:
    folder = Path(__file__).parents[2] / "native" / "fuzz"
    assert {path.stem for path in folder.glob("fuzz_*.cpp")} == set(native_seeds.HARNESSES)


@pytest.mark.sweep
def test_a_campaign_goes_on_where_it_was_and_makes_a_table_with_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.fuzz.campaign.BLOCK_S", 0.1)
    campaign = Campaign(tmp_path, 3, only="zstd, tiny")
    assert list(campaign.run(1)) == ["zstd, tiny"]
    again = Campaign(tmp_path, 3, only="zstd, tiny")
    assert again.total == campaign.total > 0
    assert again.counts["zstd, tiny"].next == campaign.counts["zstd, tiny"].next
    assert json.loads((tmp_path / "state.json").read_text())["cases"] == campaign.total
    page = written(f"before\n{BEGIN}old\n{END}after\n", tables(tmp_path))
    assert "| zstd |" in page
    assert "| **all of tiny** |" in page
    assert "old" not in page
    assert page.endswith("after\n")
    other = Campaign(tmp_path / "other", 4, only="zstd, tiny")
    (tmp_path / "other").mkdir()
    assert list(other.run(1)) == ["zstd, tiny"]
    assert f"| **all** | {campaign.total + other.total:,} |" in tables(tmp_path, tmp_path / "other")
    with pytest.raises(SystemExit, match="of one seed"):
        tables(tmp_path, tmp_path)
    assert tables(tmp_path, others=True) == ""
    sensors = Campaign(tmp_path / "sensors", 5, only="zstd, vlp16", others=True)
    (tmp_path / "sensors").mkdir()
    assert list(sensors.run(1)) == ["zstd, vlp16"]
    text = tables(tmp_path / "sensors", others=True)
    both = written(f"{page}{BEGIN_OTHERS}{END_OTHERS}", text, others=True)
    assert both.startswith(page)
    assert "| **all of vlp16** |" in both
    assert written(both, tables(tmp_path / "sensors")) == both


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
