"""What an operator may get wrong is told with the field and what would be right."""

from __future__ import annotations

import doctest

import pytest

from lidarcodec.errors import SettingsError
from lidarcodec.pipeline import StreamEncoder, check
from lidarcodec.reduction import base, make_reducer, names, table
from lidarcodec.settings import StreamSettings


@pytest.mark.parametrize(
    ("settings", "field", "says"),
    [
        (
            {"reduction": "voxels"},
            "reduction",
            "unknown reduction 'voxels': choose one of auto, all, lattice:n, columns:n, random, voxel",
        ),
        ({"reduction": "voxel:3"}, "reduction", "takes no value after a colon"),
        ({"reduction": "columns"}, "reduction", "n from 1 to 1000"),
        ({"reduction": "lattice:65"}, "reduction", "n from 1 to 64"),
        ({"reduction": "lattice"}, "reduction", "n from 1 to 64"),
        ({"reduction": "columns:"}, "reduction", "n from 1 to 1000"),
        ({"reduction": "columns:0"}, "reduction", "n from 1 to 1000"),
        ({"reduction": "columns:-4"}, "reduction", "n from 1 to 1000"),
        ({"reduction": "columns:99999999999"}, "reduction", "n from 1 to 1000"),
        ({"reduction": "columns:٣"}, "reduction", "n from 1 to 1000"),
        ({"reduction": ""}, "reduction", "unknown reduction ''"),
        ({"keep_points": 1000}, "keep_points", "has no effect on reduction 'auto'.* choose one of random, voxel"),
        ({"keep_fraction": 0.5}, "keep_fraction", "has no effect"),
        ({"reduction": "columns:4", "keep_points": 9000}, "keep_points", "has no effect"),
    ],
)
def test_settings_that_cannot_be_followed_say_why(settings: dict[str, object], field: str, says: str) -> None:
    for ask in (check, make_reducer, StreamEncoder):
        with pytest.raises(SettingsError, match=says) as caught:
            ask(StreamSettings(**settings))
        assert caught.value.field == field


def test_settings_that_can_be_followed() -> None:
    for name in names():
        settings = StreamSettings(reduction=table.example_of(name))
        assert check(settings) is settings
    assert check(StreamSettings(reduction="voxel", keep_points=4500)).keep_points == 4500


def test_a_reducer_with_an_argument_has_an_example_of_it() -> None:
    """Pages offer the example, and the contract tests use it."""
    for name in names():
        chosen = table.reduction(name)
        assert (chosen.argument is None) == (chosen.example is None), f"give REDUCTION of {name} an `example=`"


def test_documentation_examples() -> None:
    assert doctest.testmod(table).failed == 0
    assert doctest.testmod(base).failed == 0
