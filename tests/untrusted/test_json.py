"""JSON from elsewhere cannot break who reads it: what is nested, huge, infinite or unwritable is refused in one way."""

from __future__ import annotations

import contextlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidarcodec.untrusted.json import MAX_DEPTH, JsonRefusedError, read_json, read_object

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("ab\"\\[{"), inner, max_size=4),
    max_leaves=7,
)  # fmt: skip


@given(PLAIN)
def test_what_is_in_bounds_is_read_as_json_reads_it(value: object) -> None:
    assert read_json(json.dumps(value)) == value


@pytest.mark.parametrize(
    ("document", "said"),
    [
        (b"[" * 300 + b"]" * 300, "deep"),
        (b'{"a":' * 17 + b"1" + b"}" * 17, "deep"),
        (b"[" * 65_000, "deep"),
        (b'{"a": NaN}', "NaN"),
        (b"[-Infinity]", "Infinity"),
        (b"[1e999]", "range"),
        (b"9" * 4000, "digits"),
        (b'"\\ud800"', "surrogate"),
        (b'"a\\u0000b"', "zero"),
        (b"\xff\xfe", "malformed JSON"),
        (b"", "malformed JSON"),
        (b'"' + b"x" * 70_000 + b'"', "bytes"),
        ("\ud800", "malformed JSON"),
    ],
)
def test_what_would_fail_later_is_refused_with_its_reason(document: bytes | str, said: str) -> None:
    with pytest.raises(JsonRefusedError, match=said):
        read_json(document)


@given(st.binary(max_size=64) | st.text('[]{}"\\,:0eE-u', max_size=64).map(str.encode))
def test_no_bytes_raise_anything_else(data: bytes) -> None:
    with contextlib.suppress(JsonRefusedError):
        read_json(data)


def test_brackets_within_text_are_not_depth() -> None:
    value = {"x": "[" * 100 + '\\"' + "{" * 100, "y": [["]"]]}
    assert read_object(json.dumps(value)) == value
    nested: object = 1
    for _ in range(MAX_DEPTH):
        nested = [nested]
    assert read_json(json.dumps(nested)) == nested


def test_an_object_is_asked_for() -> None:
    with pytest.raises(JsonRefusedError, match="not a JSON object"):
        read_object(b"[]")
