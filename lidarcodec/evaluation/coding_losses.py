"""CodingLosses: what coding took from the frames that came over a network, as far as a receiver can know it.

The columns that were sent are counted in the frames. What else was left out, and how exact the rest is, stands in the
vehicle's status. A receiver has no originals, so it compares nothing.

>>> losses = CodingLosses()
>>> losses.told({"settings": {"codec": "pcodec"}, "rate": {"max_error_m": 0.05, "intensity": "off"}})
>>> losses.text()
', ranges off by at most 0.05 m, intensities left out'
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from lidarcodec.codecs import table
from lidarcodec.errors import UnknownNameError
from lidarcodec.frame import Frame
from lidarcodec.settings import AUTO, LATTICE

LOSSLESS: Final = "lossless"
MOST: Final = 32
"""Most ways of coding intensities that are remembered."""


class CodingLosses:
    """Over all frames of a stream that were taken.

    intensity: ways in which intensities were coded, in the order in which they came
    """

    def __init__(self) -> None:
        self._columns = self._sent = 0
        self._returns = self._kept = 0
        self._largest_m: float | None = None
        self._bounded = True
        self._status: Mapping[str, Any] | None = None
        self.intensity: list[str] = []

    @property
    def returns_percent(self) -> float | None:
        """Returns that were sent, in percent, as if every column had as many; None before the first frame."""
        if not self._columns:
            return None
        return 100.0 * (self._sent / self._columns) * (self._kept / self._returns if self._returns else 1.0)

    @property
    def max_error_m(self) -> float | None:
        """Largest bound that was in force; None if the codec keeps none, or before the first status."""
        return self._largest_m if self._bounded else None

    def add(self, frame: Frame, status: Mapping[str, Any] | None) -> None:
        """Add a frame, and the vehicle's last status."""
        self._columns += frame.width
        self._sent += frame.width if frame.lattice is None else len(frame.lattice)
        if status is not None and status is not self._status:
            self._status = status
            self.told(status)

    def told(self, status: Mapping[str, Any]) -> None:
        """Add what a status says of the coding in force. Fields of other versions are left out."""
        settings, rate, reduction = (_fields(status.get(name)) for name in ("settings", "rate", "reduction"))
        returns, kept = reduction.get("returns"), reduction.get("kept")
        columns = str(reduction.get("name")).partition(":")[0] == LATTICE  # counted in the frames
        if not columns and isinstance(returns, int) and isinstance(kept, int) and 0 <= kept <= returns:
            self._returns += returns
            self._kept += kept
        bound = rate.get("max_error_m", settings.get("max_error_m"))
        base = settings.get("base_error_m")  # refinements are counted apart
        if bound is None and not _exact(status.get("codec", settings.get("codec"))):
            self._bounded = False
        numbers = [float(one) for one in (bound, base, self._largest_m, 0.0) if isinstance(one, int | float)]
        self._largest_m = max(numbers)
        intensity = rate.get("intensity", settings.get("intensity", LOSSLESS))
        intensity = LOSSLESS if intensity == AUTO else intensity
        if isinstance(intensity, str) and intensity not in self.intensity and len(self.intensity) < MOST:
            self.intensity.append(intensity)

    def values(self) -> dict[str, Any]:
        """All of it as plain values."""
        percent = self.returns_percent
        return {
            "returns_percent": None if percent is None else round(percent, 2),
            "max_error_m": self.max_error_m,
            "intensity": list(self.intensity),
        }

    def text(self) -> str:
        """The losses in a few words, each after a comma; empty if there are none, or none are known."""
        percent = self.returns_percent
        kept = f", about {percent:.1f} % of the returns sent" if percent is not None and percent < 99.95 else ""
        far = "" if self._bounded else ", ranges off by no known bound"
        if self._bounded and self._largest_m:
            far = f", ranges off by at most {self._largest_m:.3g} m"
        return kept + far + self._intensity_text()

    def _intensity_text(self) -> str:
        values = sorted(int(one) for one in self._numbers_of("levels"))
        errors = sorted(int(one) for one in self._numbers_of("error"))
        few = f"{values[0]} to {values[-1]}" if values and values[0] < values[-1] else "".join(map(str, values[:1]))
        ways = ["left out"] * ("off" in self.intensity)
        ways += [f"in {few} values"] if values else []
        ways += [f"off by at most {errors[-1]}"] if errors else []
        return f", intensities {' or '.join(ways)}" if ways else ""

    def _numbers_of(self, name: str) -> list[str]:
        found = (one.partition("=") for one in self.intensity)
        return [number for way, _, number in found if way == name and number.isdecimal() and len(number) < MOST]


def _fields(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _exact(codec: object) -> bool:
    """Whether a codec is exact where no bound is set."""
    try:
        return isinstance(codec, str) and table.codec(codec).bounded
    except UnknownNameError:
        return False
