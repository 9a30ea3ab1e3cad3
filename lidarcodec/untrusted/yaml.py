"""The one reader of YAML that comes from elsewhere.

It knows what configurations and calibrations need: mappings, lists, text, numbers. Anchors, tags and deep nesting turn
a few bytes into much, or into anything; numbers in base 60 or with half a million digits hold a program for minutes.
A field that is there twice is refused, because it is unknown which one was meant.

>>> read_yaml(b"sensors: [{name: roof, rate: 10}]")
{'sensors': [{'name': 'roof', 'rate': 10}]}
>>> read_yaml(b"a: &x [1]")
Traceback (most recent call last):
  ...
lidarcodec.untrusted.yaml.YamlRefusedError: it uses YAML anchors or tags, which are not allowed
"""

from __future__ import annotations

import math
from typing import Any, Final

import yaml

from lidarcodec.budgets import MIB

MAX_BYTES: Final = MIB
MAX_DEPTH: Final = 16
MAX_TOKENS: Final = 60_000
"""A calibration of 128 lasers has 15,000."""
MAX_NUMBER: Final = 40
"""Characters of a number."""

# The C loader is ten times as fast. Both refuse every tag but the plain ones.
_BASE: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_OPENING: Final = (
    yaml.BlockSequenceStartToken,
    yaml.BlockMappingStartToken,
    yaml.FlowSequenceStartToken,
    yaml.FlowMappingStartToken,
)
_CLOSING: Final = (yaml.BlockEndToken, yaml.FlowSequenceEndToken, yaml.FlowMappingEndToken)
_GIVES_MUCH: Final = (yaml.AliasToken, yaml.AnchorToken, yaml.TagToken)
# PyYAML lets errors of its conversions through: a date of month 13 is a ValueError, and so on.
_NOT_YAML: Final = (yaml.YAMLError, ValueError, LookupError, ArithmeticError, RecursionError, AttributeError, TypeError)


class YamlRefusedError(ValueError):
    """No YAML, or YAML beyond the limits; the text completes "the file is refused: ..."."""


class _Loader(_BASE):  # type: ignore[misc]
    """Numbers as people write them."""


def _number(loader: Any, node: Any) -> Any:
    text = str(node.value)
    if len(text) > MAX_NUMBER or ":" in text:
        raise YamlRefusedError(f"the number {text[:24]}... is written in {len(text)} characters or in base 60")
    whole = node.tag == "tag:yaml.org,2002:int"
    value = loader.construct_yaml_int(node) if whole else loader.construct_yaml_float(node)
    if not whole and not math.isfinite(value):
        raise YamlRefusedError(f"the number {text[:24]} is out of range")
    return value


def _mapping(loader: Any, node: Any) -> Any:
    names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
    if len(set(names)) < len(names):
        twice = next(name for at, name in enumerate(names) if name in names[:at])
        raise YamlRefusedError(f"the field {twice[:40]!r} is there twice")
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:map", _mapping)
_Loader.add_constructor("tag:yaml.org,2002:int", _number)
_Loader.add_constructor("tag:yaml.org,2002:float", _number)


def read_yaml(data: bytes | str) -> Any:
    """The value of a YAML document of at most 1 MiB, nested at most 16 deep, without anchors and tags.

    Its numbers are finite, of at most 40 characters and not in base 60. No field of a mapping is there twice.
    Cost: 0.1 s for a calibration of 64 lasers.

    Raises YamlRefusedError, a ValueError, for everything else, and nothing but that.
    """
    if len(data) > MAX_BYTES:
        raise YamlRefusedError(f"it has more than {MAX_BYTES:,} bytes")
    try:
        _check_tokens(data)
        return yaml.load(data, _Loader)
    except YamlRefusedError:
        raise
    except _NOT_YAML as error:
        raise YamlRefusedError(f"it is not YAML: {_first_line(error)}") from None


def _check_tokens(data: bytes | str) -> None:
    depth = 0
    for number, token in enumerate(yaml.scan(data, _BASE)):
        if isinstance(token, _GIVES_MUCH):
            raise YamlRefusedError("it uses YAML anchors or tags, which are not allowed")
        depth += isinstance(token, _OPENING) - isinstance(token, _CLOSING)
        if depth > MAX_DEPTH:
            raise YamlRefusedError(f"it is nested more than {MAX_DEPTH} deep")
        if number > MAX_TOKENS:
            raise YamlRefusedError("it has too many fields")


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__
