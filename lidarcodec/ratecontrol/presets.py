"""Presets for links: a purpose, a codec and a target bitrate for each kind of link.

>>> PRESETS["1mbit"].settings
{'purpose': 'look', 'codec': 'auto', 'target_kbps': 800.0}
>>> preset("2mbit").target_kbps, preset("lan").target_kbps
(1600.0, None)
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from lidarcodec.errors import SettingsError
from lidarcodec.settings import AUTO, Purpose, StreamSettings

ROOM: Final = 0.8
"""Target of a preset as a share of the link's bitrate. At 80 % a link has no queue; at 91 % it has one."""


class Preset(NamedTuple):
    """name: name on the command line;  label: text for people;  others: settings of a stream"""

    name: str
    label: str
    purpose: Purpose
    codec: str
    target_kbps: float | None

    @property
    def settings(self) -> dict[str, Any]:
        """The settings of the preset."""
        return {"purpose": self.purpose, "codec": self.codec, "target_kbps": self.target_kbps}

    def told(self, settings: StreamSettings) -> str:
        """What a preset sets of these settings, as on the command line, and which of its own others replaced.

        >>> preset("1mbit").told(StreamSettings(purpose="look", codec="pcodec", target_kbps=800))
        'purpose=look, target_kbps=800; codec=pcodec is used, as given'
        """
        found = {key: getattr(settings, key) for key in self.settings}
        here = [_said(key, value) for key, value in found.items() if value == self.settings[key]]
        others = [_said(key, value) for key, value in found.items() if value != self.settings[key]]
        are = "is" if len(others) == 1 else "are"
        return (", ".join(here) or "nothing") + f"; {', '.join(others)} {are} used, as given" * bool(others)


PRESETS: Final = {
    one.name: one
    for one in (
        Preset("1mbit", "Mobile 1 Mbit/s", "look", AUTO, 1000 * ROOM),
        Preset("2mbit", "Mobile 2 Mbit/s", "look", AUTO, 2000 * ROOM),
        Preset("5mbit", "Mobile 5 Mbit/s", "look", AUTO, 5000 * ROOM),
        Preset("lan", "Local network: everything, exact", "look", AUTO, None),
    )
}


def preset(name: str) -> Preset:
    """The preset with this name.

    Raises SettingsError.
    """
    if name not in PRESETS:
        raise SettingsError(f"--link must be one of {', '.join(PRESETS)}, not '{name}'; another bitrate is "
                            "--codec auto --set target_kbps=VALUE", "link")  # fmt: skip
    return PRESETS[name]


def _said(key: str, value: object) -> str:
    return f"{key}={'null' if value is None else f'{value:g}' if isinstance(value, float) else value}"
