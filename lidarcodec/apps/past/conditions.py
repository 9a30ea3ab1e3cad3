"""Conditions: what in the status of a publisher marks the last seconds as an event.

>>> condition = Condition("worker_restarts grows")
>>> [condition.came({"worker_restarts": value}) for value in (1, 1, 2, 2)]
[False, False, True, False]
>>> condition = Condition("flight.in_flight >= 2")
>>> [condition.came({"flight": {"in_flight": value}}) for value in (1, 2, 3, 1, 2)]
[False, True, False, False, True]
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

from lidarcodec.errors import SettingsError
from lidarcodec.recording.marks import MAX_TEXT

MAX_CONDITIONS: Final = 16
_FORM: Final = re.compile(r"([^<>=]{1,150}?)\s*(?:(grows)|(>=|<=|>|<|=)\s*(-?\d{1,15}(?:\.\d{1,9})?))", re.ASCII)
_COMPARE: Final[dict[str, Callable[[float, float], bool]]] = {
    ">": operator.gt,
    "<": operator.lt,
    ">=": operator.ge,
    "<=": operator.le,
    "=": operator.eq,
}


class Condition:
    """A condition on a number in the status: `FIELD > NUMBER`, also with < >= <= =, or `FIELD grows`.

    text: as it was given. FIELD is the name of a field, with a dot before each inner one: `source.lost packets`
    """

    def __init__(self, text: str) -> None:
        """Raises SettingsError for any other text."""
        found = _FORM.fullmatch(text.strip())
        if found is None or len(text) > MAX_TEXT:
            raise SettingsError(
                f"'{text[:80]}' is not a condition: write FIELD > NUMBER, or FIELD grows, such as "
                "'worker_restarts grows'",
                "mark_when",
            )
        self.text = text.strip()
        field, grows, sign, number = found.groups()
        self._path, self._grows = field.strip().split("."), grows is not None
        self._sign, self._number = sign, float(number or 0.0)
        self._last: float | None = None
        self._held = False

    def came(self, status: Mapping[str, Any]) -> bool:
        """Whether the condition holds now and did not hold in the last status. Without the field, it does not hold."""
        value: Any = status
        for name in self._path:
            value = value.get(name) if isinstance(value, Mapping) else None
        if isinstance(value, bool) or not isinstance(value, int | float):
            self._held = False
            return False
        if self._grows:
            last, self._last = self._last, float(value)
            return last is not None and value > last
        before, self._held = self._held, _COMPARE[self._sign](float(value), self._number)
        return self._held and not before


def conditions_of(texts: tuple[str, ...]) -> tuple[Condition, ...]:
    """Raises SettingsError if one is not valid, or there are too many."""
    if len(texts) > MAX_CONDITIONS:
        raise SettingsError(f"there are at most {MAX_CONDITIONS} conditions", "mark_when")
    return tuple(map(Condition, texts))
