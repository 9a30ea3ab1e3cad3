"""What a configuration says is what its author wrote, or it is refused."""

from __future__ import annotations

import pytest

from lidarcodec.untrusted.yaml import YamlRefusedError, read_yaml


@pytest.mark.parametrize(
    "text",
    ["roof: [0]\nleft: [1]\nroof: [2]", "sensors: [{name: roof, rate: 1, rate: 2}]", "{a: 1, 'a': 2}", "1: a\n1: b"],
)
def test_a_field_that_is_there_twice_is_refused(text: str) -> None:
    """The last one counted, without a word: a sensor of mounts.yaml was drawn metres beside its place."""
    with pytest.raises(YamlRefusedError, match="is there twice"):
        read_yaml(text)


def test_fields_of_different_mappings_may_have_one_name() -> None:
    text = "sensors: [{name: roof, at: {x: 1}}, {name: left, at: {x: 2}}]\nname: car-7"
    sensors = [{"name": "roof", "at": {"x": 1}}, {"name": "left", "at": {"x": 2}}]
    assert read_yaml(text) == {"sensors": sensors, "name": "car-7"}
    assert read_yaml("a: {b: 1, <<: {b: 2, c: 3}}") == {"a": {"b": 1, "c": 3}}
