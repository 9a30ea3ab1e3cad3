"""The options in the query of a viewer's socket.

>>> CloudOptions.of({"attributes": "ring", "max_points": "50000"}).encoding
Encoding(form='points', attributes=('ring',), max_points=50000, fill=False)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple, get_args

from lidarcodec.errors import SettingsError

View = Literal["range", "cloud"]
"""Kinds of pictures of a frame."""
Form = Literal["points", "range"]
ATTRIBUTES: Final[dict[Form, tuple[str, ...]]] = {
    "points": ("intensity", "ring", "range", "filled"),
    "range": ("intensity", "original", "filled"),
}
"""Optional arrays besides the coordinates or the range image, in the order in which they are sent. `filled` is sent
only with frames that have interpolated returns, and `original` only with frames that have one."""
DEFAULT_ATTRIBUTES: Final[dict[Form, str]] = {"points": "intensity,ring,filled", "range": "intensity,filled"}
MAX_POINTS: Final = 2**22
MAX_RATE: Final = 1000.0
MAX_WINDOW: Final = 8


class Encoding(NamedTuple):
    """The options that determine the bytes of a frame: viewers with the same encoding share them.

    fill: whether to interpolate returns in a thinned frame, between those that were sent
    """

    form: Form
    attributes: tuple[str, ...]
    max_points: int | None
    fill: bool = False


@dataclass(frozen=True)
class FramesOptions:
    """window: most messages that are sent before the viewer has acknowledged the first of them"""

    window: int = 1

    @classmethod
    def of(cls, query: Mapping[str, str]) -> FramesOptions:
        """Read a query. Raises SettingsError with the field."""
        _only(query, "window")
        return cls(_whole(query, "window", MAX_WINDOW) or 1)

    def shown(self) -> dict[str, Any]:
        """The options as fields of the event `hello`."""
        return {"window": self.window}


@dataclass(frozen=True)
class CloudOptions:
    """rate: most frames a second, None for all;  window: that of `FramesOptions`"""

    encoding: Encoding
    rate: float | None = None
    window: int = 1

    @classmethod
    def of(cls, query: Mapping[str, str], fill: bool = True) -> CloudOptions:
        """Read a query.

        fill: the default of `fill` for a viewer that asks for the array `filled`

        Raises SettingsError with the field.
        """
        _only(query, "form", "attributes", "max_points", "fill", "rate", "window")
        form = next((known for known in get_args(Form) if known == query.get("form", "points")), None)
        if form is None:
            raise SettingsError(f"form must be {' or '.join(get_args(Form))}, not '{query['form'][:40]}'", "form")
        wanted = [name for name in query.get("attributes", DEFAULT_ATTRIBUTES[form]).split(",") if name]
        for name in wanted:
            if name not in ATTRIBUTES[form]:
                known = ", ".join(ATTRIBUTES[form])
                raise SettingsError(
                    f"form {form} has no attribute '{name[:40]}': its attributes are {known}", "attributes"
                )
        max_points = _whole(query, "max_points", MAX_POINTS)
        if max_points is not None and form == "range":
            raise SettingsError("max_points works only with form=points", "max_points")
        attributes = tuple(name for name in ATTRIBUTES[form] if name in wanted)
        given = query.get("fill", "1" if fill and "filled" in attributes else "0")
        if given not in ("0", "1"):
            raise SettingsError("fill must be 0 or 1", "fill")
        encoding = Encoding(form, attributes, max_points, given == "1")
        return cls(encoding, _rate(query), _whole(query, "window", MAX_WINDOW) or 1)

    def shown(self) -> dict[str, Any]:
        """The options as fields of the event `hello`."""
        encoding = self.encoding._asdict() | {"attributes": list(self.encoding.attributes)}
        return encoding | {"rate": self.rate, "window": self.window}


def _only(query: Mapping[str, str], *known: str) -> None:
    for name in query:
        if name not in known:
            raise SettingsError(f"unknown option '{name[:40]}': choose one of {', '.join(known)}", name[:40])


def _whole(query: Mapping[str, str], name: str, largest: int) -> int | None:
    text = query.get(name)
    if text is None:
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 12 and 1 <= int(text) <= largest):
        raise SettingsError(f"{name} must be a whole number from 1 to {largest}", name)
    return int(text)


def _rate(query: Mapping[str, str]) -> float | None:
    text = query.get("rate")
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.01 <= value <= MAX_RATE:
        raise SettingsError(f"rate must be a number of frames a second, from 0.01 to {MAX_RATE:.0f}", "rate")
    return value
