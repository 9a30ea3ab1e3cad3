"""Parses a SOURCE of the command line into kind, place and options.

>>> spec = parse("udp://0.0.0.0:2368?src=192.168.3.43")
>>> spec.scheme, spec.place, spec.options
('udp', '0.0.0.0:2368', {'src': '192.168.3.43'})
"""

from __future__ import annotations

from dataclasses import dataclass, field
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path
from urllib.parse import parse_qsl

from lidarcodec.errors import SourceError, UnknownNameError
from lidarcodec.units import is_number

LIVE = ("udp", "ros2")
"""Kinds of sources that are live."""
TRUE, FALSE = frozenset({"1", "true", "yes", ""}), frozenset({"0", "false", "no"})


@dataclass(frozen=True)
class Spec:
    """A source's kind ("" for a path), its path or address, and the options after the question mark."""

    text: str
    scheme: str
    place: str
    options: dict[str, str] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """The place as a path."""
        return Path(self.place)

    def only(self, *known: str) -> Spec:
        """This spec, if all its options are in `known`.

        Raises UnknownNameError with the first other option.
        """
        for name in self.options:
            if name not in known:
                raise UnknownNameError(
                    f"option of {self.scheme or 'the'} source '{self.place}':", name, known or ("none",)
                )
        return self

    def number(self, name: str, low: float, high: float) -> float | None:
        """An option as a number between `low` and `high`; None if it was not given.

        Raises SourceError otherwise.
        """
        text = self.options.get(name)
        if text is None:
            return None
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise SourceError(f"source option {name}={text}: write a number from {low:.12g} to {high:.12g}")
        return value

    def whole(self, name: str, low: int, high: int) -> int | None:
        """An option as a whole number; None if it was not given.

        Raises SourceError otherwise.
        """
        value = self.number(name, low, high)
        if value is not None and value != int(value):
            raise SourceError(f"source option {name}={self.options[name]}: write a whole number")
        return None if value is None else int(value)

    def model(self) -> str | None:
        """The option `model` as the name that is used here: `VLP-16` is `vlp16`. None if it was not given."""
        from lidarcodec.sensors.models.table import names

        text = self.options.get("model")
        return text if text is None else next((name for name in names() if _plain(name) == _plain(text)), text)

    def position_port(self) -> int | None:
        """The port of position packets: option `position`, 0 for `off`; None if it was not given.

        Raises SourceError if it is not a port.
        """
        return 0 if self.options.get("position") == "off" else self.whole("position", 1, 65535)

    def host_and_port(self) -> tuple[str, int | None]:
        """Host, without brackets, and port of the place `HOST:PORT`, `:PORT`, `PORT` or `HOST`; no port: None.

        Raises SourceError if the port is not a number up to 65535.
        """
        host, _, port = self.place.rpartition(":") if not self.place.endswith("]") else (self.place, "", "")
        if not host and not port.isdigit():
            host, port = port, ""
        if port and not is_number(port, 65535):
            raise SourceError(f"{self.text}: {port} is no port: write a number up to 65535")
        return host.strip("[]"), int(port) if port else None

    def flag(self, name: str) -> bool:
        """An option that is on or off; off if it was not given.

        Raises SourceError if it is neither.
        """
        text = self.options.get(name, "no").lower()
        if text not in TRUE | FALSE:
            raise SourceError(f"source option {name}={text}: write 1 or 0")
        return text in TRUE


def _plain(name: str) -> str:
    return "".join(filter(str.isalnum, name.lower()))


def address_of(text: str) -> IPv4Address | IPv6Address:
    """The sender's address in an option `src`.

    Raises SourceError if it is not an address.
    """
    try:
        return ip_address(text)
    except ValueError:
        raise SourceError(f"source option src={text}: write an IP address") from None


def parse(text: str | Path, schemes: tuple[str, ...] = ("udp", "ros2", "sim")) -> Spec:
    """The spec of a path or an address. A file whose name has a question mark is found by its full name first.

    Raises UnknownNameError for an address of a kind that does not exist, SourceError for an empty text.
    """
    name = str(text)
    if not name:
        raise SourceError("no source given: write a path, udp://HOST:PORT, ros2:/TOPIC or sim:city")
    if isinstance(text, Path) or Path(name).exists():
        return Spec(name, "", name)
    place, _, query = name.partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    scheme, colon, rest = place.partition(":")
    if colon and scheme in schemes:
        return Spec(name, scheme, rest.removeprefix("//"), options)
    if "://" in place:
        raise UnknownNameError("kind of source", scheme, ("a path", *schemes))
    return Spec(name, "", place, options)
