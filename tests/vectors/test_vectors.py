"""The shared test vectors say what our decoder gives: a change of either would mislead every other decoder."""

from __future__ import annotations

import json

import pytest

from tests.vectors.make import FOLDER, GOLDEN, expected, golden_files, split, streams


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.json")), ids=lambda path: path.stem)
def test_a_vector_says_what_the_decoder_gives(path):
    golden = path.stem.startswith("golden_")
    messages = GOLDEN / f"{path.stem.removeprefix('golden_')}.bin" if golden else path.with_suffix(".bin")
    assert expected(messages.read_bytes()) == json.loads(path.read_text())


def test_no_vector_is_missing():
    names = {path.stem for path in FOLDER.glob("*.json")}
    assert names == {*streams(), *(f"golden_{path.stem}" for path in golden_files())}, "python -m tests.vectors.make"


def test_vectors_are_few_and_small():
    for others in (False, True):
        chosen = [path for path in FOLDER.glob("*.bin") if path.stem.startswith("other_") == others]
        assert sum(path.stat().st_size for path in chosen) < 170_000
    assert all(len(list(split(path.read_bytes()))) == 10 for path in FOLDER.glob("*.bin"))
