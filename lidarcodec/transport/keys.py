"""The keys of a stream (docs/wire-format.md), and matching of key expressions.

>>> keys = StreamKeys("car-7", "roof")
>>> keys.frame, keys.arrived("server")
('lidarcodec/v1/car-7/roof/frame', 'lidarcodec/v1/car-7/roof/arrived/server')
>>> StreamKeys.parse("lidarcodec/v1/car-7/roof") == keys
True
>>> matches("lidarcodec/v1/*/*/alive", "lidarcodec/v1/car-7/roof/alive")
True
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from lidarcodec.errors import SettingsError, TransportError
from lidarcodec.settings import valid_name

PREFIX = "lidarcodec/v1"
SERVER_RECEIVER = "server"
"""Name of the server in arrival reports; publishers follow it by default."""


@dataclass(frozen=True)
class StreamKeys:
    """Keys of one stream; names are 1 to 64 of A-Z a-z 0-9 _ . -"""

    vehicle: str = "vehicle"
    sensor: str = "lidar"

    def __post_init__(self) -> None:
        valid_name(self.vehicle, "vehicle")
        valid_name(self.sensor, "sensor")

    @classmethod
    def parse(cls, key: str) -> StreamKeys:
        """From `lidarcodec/v1/VEHICLE/SENSOR`, or just `VEHICLE/SENSOR`.

        Raises SettingsError for any other text.
        """
        parts = key.removeprefix(PREFIX + "/").split("/")
        if len(parts) != 2:
            raise SettingsError(f"'{key}' is not a stream: write {PREFIX}/VEHICLE/SENSOR or VEHICLE/SENSOR", "key")
        return cls(*parts)

    @property
    def prefix(self) -> str:
        """The prefix of all keys of the stream."""
        return f"{PREFIX}/{self.vehicle}/{self.sensor}"

    @property
    def frame(self) -> str:
        """Messages."""
        return f"{self.prefix}/frame"

    @property
    def original(self) -> str:
        """Frames before coding, for comparisons on the same machine."""
        return f"{self.prefix}/original"

    @property
    def control_get(self) -> str:
        """Query: settings and status."""
        return f"{self.prefix}/control/get"

    @property
    def control_set(self) -> str:
        """Query: change settings."""
        return f"{self.prefix}/control/set"

    @property
    def control_reset(self) -> str:
        """Query: the settings with which the publisher was started."""
        return f"{self.prefix}/control/reset"

    @property
    def control_keyframe(self) -> str:
        """Query: a key frame, soon."""
        return f"{self.prefix}/control/keyframe"

    @property
    def status(self) -> str:
        """JSON once a second from the publisher."""
        return f"{self.prefix}/status"

    @property
    def past(self) -> str:
        """Query: what the vehicle kept, and parts of it."""
        return f"{self.prefix}/past"

    @property
    def past_mark(self) -> str:
        """Query: keep a part of the past from being overwritten."""
        return f"{self.prefix}/past/mark"

    def refine(self, sector: int | str = "*") -> str:
        """Refinements of one sector (0 to 11), or of all."""
        return f"{self.prefix}/refine/{sector}"

    def refined(self, receiver: str = "*") -> str:
        """Arrival reports of refinements, from one receiver or from all."""
        return f"{self.prefix}/refined/{receiver if receiver == '*' else valid_name(receiver, 'receiver')}"

    @property
    def alive(self) -> str:
        """Liveliness token of the publisher."""
        return f"{self.prefix}/alive"

    @property
    def odometry(self) -> str:
        """JSON from the vehicle, if it knows where it is: stamp and T_world_sensor."""
        return f"{self.prefix}/odometry"

    def pose(self, receiver: str = "*") -> str:
        """JSON a scan from one receiver that finds the sensor in a map, or from all."""
        return f"{self.prefix}/pose/{receiver if receiver == '*' else valid_name(receiver, 'receiver')}"

    def arrived(self, receiver: str = "*") -> str:
        """Arrival reports, and liveliness tokens, of one receiver or of all."""
        return f"{self.prefix}/arrived/{receiver if receiver == '*' else valid_name(receiver, 'receiver')}"

    def report(self, receiver: str = "*") -> str:
        """JSON once a second from one receiver or from all."""
        return f"{self.prefix}/report/{receiver if receiver == '*' else valid_name(receiver, 'receiver')}"


def check_key(key: str, *, wild: bool = False) -> str:
    """The key itself, after a check.

    Raises TransportError if it is not a valid key, or has a wildcard although none is allowed.
    """
    parts = key.split("/")
    if not key or not all(parts) or any(sign in key for sign in "?#$"):
        raise TransportError(f"'{key}' is not a key: write names separated by single slashes, without ? # $")
    if any("*" in part and part not in ("*", "**") for part in parts):
        raise TransportError(f"'{key}' is not a key: * and ** must be whole parts")
    if not wild and "*" in key:
        raise TransportError(f"'{key}' has wildcards, but must be a single key")
    return key


@lru_cache(maxsize=256)
def matches(expression: str, key: str) -> bool:
    """Whether a key expression (`*` one part, `**` any number of parts, or none) covers a key."""

    def covers(wanted: tuple[str, ...], parts: tuple[str, ...]) -> bool:
        if not wanted:
            return not parts
        if wanted[0] == "**":
            return covers(wanted[1:], parts) or (bool(parts) and covers(wanted, parts[1:]))
        return bool(parts) and wanted[0] in ("*", parts[0]) and covers(wanted[1:], parts[1:])

    return covers(tuple(expression.split("/")), tuple(key.split("/")))
