"""A retention policy: which segments `recompress` encodes again, how long after they were recorded, and how. One file:

    [[rule]]
    after_days = 30
    vehicle = "car-*"                    # optional, as sensor
    codec = "pcodec"
    set = { max_error_m = 0.02 }

    [[rule]]
    after_days = 365
    codec = "predictive"
    set = { max_error_m = 0.05, reduction = "voxel", keep_fraction = 0.5 }

Of the rules that fit a segment, the one with the most days counts. A segment that none fits stays as it is.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final

from lidarcodec.archive.names import Commit
from lidarcodec.errors import SettingsError
from lidarcodec.files.regular import open_regular
from lidarcodec.settings import StreamSettings

MAX_BYTES: Final = 1 << 20
MAX_DAYS: Final = 100_000
_DAY_NS: Final = 86_400 * 10**9
_KEYS: Final = frozenset({"after_days", "vehicle", "sensor", "codec", "set"})
Made = Callable[[str | None, Mapping[str, Any]], StreamSettings]
"""Checked settings of a codec and of `set`."""


@dataclass(frozen=True)
class Rule:
    """after_days: since the last frame of a segment;  vehicle, sensor: patterns of names;  settings: plain values"""

    after_days: float
    vehicle: str
    sensor: str
    settings: dict[str, Any]


class Policy:
    """Rules of a file. now_ns: the time from which ages are counted, ns since the Unix epoch"""

    def __init__(self, rules: list[Rule], now_ns: int) -> None:
        self._rules = sorted(rules, key=lambda rule: -rule.after_days)
        self._now_ns = now_ns

    @classmethod
    def of(cls, path: Path, now_ns: int, made: Made) -> Policy:
        """The policy in a file. Raises SettingsError, UnknownNameError or OSError if it cannot be used."""
        with open_regular(path) as file:
            data = file.read(MAX_BYTES + 1)
        try:
            if len(data) > MAX_BYTES:
                raise SettingsError(f"{path} has more than {MAX_BYTES:,} bytes", "policy")
            found = tomllib.loads(data.decode())
            rules = found.pop("rule", None)
            if found or not isinstance(rules, list) or not rules:
                raise SettingsError(f"{path} must have only [[rule]] tables", "policy")
            return cls([_rule(number, one, made) for number, one in enumerate(rules, 1)], now_ns)
        except ValueError as error:  # no TOML, no UTF-8
            raise SettingsError(f"{path} is not a policy: {error}", "policy") from None

    def settings_for(self, commit: Commit) -> dict[str, Any] | None:
        """Plain settings that a segment should have; None if it should stay as it is."""
        for rule in self._rules:
            old = commit.last_ns + rule.after_days * _DAY_NS < self._now_ns
            if old and fnmatchcase(commit.vehicle, rule.vehicle) and fnmatchcase(commit.sensor, rule.sensor):
                return rule.settings
        return None


def _rule(number: int, values: Any, made: Made) -> Rule:
    name = f"rule {number}"
    if not isinstance(values, dict) or not _KEYS.issuperset(values):
        raise SettingsError(f"{name} may have only {', '.join(sorted(_KEYS))}", "policy")
    days, more = values.get("after_days"), values.get("set", {})
    if isinstance(days, bool) or not isinstance(days, int | float) or not 0 <= days <= MAX_DAYS:
        raise SettingsError(f"{name} needs after_days, from 0 to {MAX_DAYS:,}", "policy")
    texts = {key: values.get(key, "*") for key in ("vehicle", "sensor")} | {"codec": values.get("codec", "")}
    if not all(isinstance(text, str) for text in texts.values()) or not isinstance(more, dict):
        raise SettingsError(f"{name}: vehicle, sensor and codec must be texts, and set must be a table", "policy")
    if not texts["codec"] and not more:
        raise SettingsError(f"{name} changes nothing: give codec or set", "policy")
    settings = made(texts["codec"] or None, more)
    return Rule(float(days), texts["vehicle"], texts["sensor"], settings.model_dump(mode="json"))
