"""Sent: what messages say of how much of their frames was sent, without decoding them.

>>> Sent().result()["columns_percent"] is None
True
"""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

from lidarcodec.codecs import table
from lidarcodec.errors import DecodeError
from lidarcodec.evaluation.plane_difference import told_of_planes
from lidarcodec.evaluation.verify import LOSSLESS_INTENSITY, bound_of, promise_of
from lidarcodec.message import Message, SectionType
from lidarcodec.planes.calibrations import peek_sensor
from lidarcodec.planes.lattice_section import read_lattice
from lidarcodec.planes.other_calibrations import Described
from lidarcodec.units import RANGE_STEP_M

LOSSLESS: Final = "lossless"
FEW: Final = "in few values"
OFF: Final = "not sent"
UNSAID: Final = "not said"
"""How intensities were sent. `raw` does not say whether theirs are all of them."""


class Sent:
    """Adds up messages: columns of their frames and those sent, bounds, and how intensities were sent.

    sensor: the first that a key message describes. Bounds follow from the range step of the last one before a message
    """

    def __init__(self) -> None:
        self.sensor: Described | None = None
        self.intensity: Counter[str] = Counter()
        self._step_m: float | None = None
        self._bounds: Counter[tuple[int | None, float | None, float | None]] = Counter()
        self._columns = self._sent = self._chosen = 0

    def add(self, message: Message) -> None:
        """Take a message.

        Raises DecodeError for a section that is damaged, UnsupportedVersionError for an unknown codec.
        """
        found = _sensor_of(message)
        if found is not None:
            self.sensor, self._step_m = self.sensor or found, found.range_step_m
        promise, frames = promise_of(message), message.frame_count
        columns = sent = message.width
        if message.has(SectionType.LATTICE):
            lattice = read_lattice(message.section(SectionType.LATTICE))
            columns, sent = lattice.width, len(lattice.columns)
        elif promise.reduced:
            self._chosen += frames
        self._columns, self._sent = self._columns + columns, self._sent + sent
        self._bounds[promise.step, promise.bound_m, self._step_m] += frames
        self.intensity[_intensity_of(message)] += frames

    def result(self) -> dict[str, Any]:
        """`columns_percent`; `least_bound_m` and `largest_bound_m`, None without one; numbers of frames:
        `without_bound`, `reduced` by choice of returns, and `intensity`, by how it was sent."""
        found = {one: self._bound_of(*one) for one in self._bounds}
        bounds = [bound for bound in found.values() if bound is not None]
        return {
            "columns_percent": round(100 * self._sent / self._columns, 2) if self._columns else None,
            "least_bound_m": min(bounds, default=None),
            "largest_bound_m": max(bounds, default=None),
            "without_bound": sum(self._bounds[one] for one, bound in found.items() if bound is None),
            "reduced": self._chosen,
            "intensity": dict(self.intensity),
        }

    def _bound_of(self, step: int | None, bound_m: float | None, step_m: float | None) -> float | None:
        """step_m: None for messages before the first key message, which are taken for those of its sensor"""
        if bound_m is not None or step is None:
            return bound_m
        first_m = RANGE_STEP_M if self.sensor is None else self.sensor.range_step_m
        return bound_of(step, first_m if step_m is None else step_m)


def bounds_text(result: dict[str, Any]) -> str:
    """The bounds for people: `0.004 to 0.084 m`."""
    least, largest = result["least_bound_m"], result["largest_bound_m"]
    if largest is None:
        return "none"
    text = f"{largest:g} m" if least == largest else f"{least:g} to {largest:g} m"
    return text + f"; {result['without_bound']} frames without a bound" * bool(result["without_bound"])


def _sensor_of(message: Message) -> Described | None:
    """The sensor that a key message describes."""
    try:
        return peek_sensor(message.section(SectionType.CALIBRATION)) if message.key else None
    except DecodeError:
        return None


def _intensity_of(message: Message) -> str:
    if message.has(SectionType.CLOUD):
        return LOSSLESS  # fields of clouds beside x, y and z are kept
    if message.planes:
        told = told_of_planes(message)
        return LOSSLESS if told.lossless else OFF if told.off else FEW
    data = bytes(message.section(SectionType.INTENSITY)[:1]) if message.has(SectionType.INTENSITY) else b""
    if not data:
        return OFF if message.width else LOSSLESS
    if table.codec_name(message.codec) == "raw":
        return UNSAID
    return LOSSLESS if data[0] in LOSSLESS_INTENSITY else FEW
