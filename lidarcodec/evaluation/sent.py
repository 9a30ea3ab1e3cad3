"""Sent: what messages say of how much of their frames was sent, without decoding them.

>>> Sent().result()["columns_percent"] is None
True
"""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

from lidarcodec.codecs import table
from lidarcodec.evaluation.plane_difference import told_of_planes
from lidarcodec.evaluation.verify import LOSSLESS_INTENSITY, bound_of, promise_of
from lidarcodec.message import Message, SectionType
from lidarcodec.planes.lattice_section import read_lattice
from lidarcodec.units import RANGE_STEP_M

LOSSLESS: Final = "lossless"
FEW: Final = "in few values"
OFF: Final = "not sent"
UNSAID: Final = "not said"
"""How intensities were sent. `raw` does not say whether theirs are all of them."""


class Sent:
    """Adds up messages: columns of their frames and those sent, bounds, and how intensities were sent. range_step_m: of
    the sensor, by which bounds are told"""

    def __init__(self) -> None:
        self.range_step_m = RANGE_STEP_M
        self.intensity: Counter[str] = Counter()
        self._bounds: Counter[float | None] = Counter()
        self._columns = self._sent = self._chosen = 0

    def add(self, message: Message) -> None:
        """Take a message.

        Raises DecodeError for a section that is damaged, UnsupportedVersionError for an unknown codec.
        """
        promise, frames = promise_of(message), message.frame_count
        columns = sent = message.width
        if message.has(SectionType.LATTICE):
            lattice = read_lattice(message.section(SectionType.LATTICE))
            columns, sent = lattice.width, len(lattice.columns)
        elif promise.reduced:
            self._chosen += frames
        self._columns, self._sent = self._columns + columns, self._sent + sent
        bound_m = promise.bound_m
        if bound_m is None and promise.step is not None:
            bound_m = bound_of(promise.step, self.range_step_m)
        self._bounds[bound_m] += frames
        self.intensity[_intensity_of(message)] += frames

    def result(self) -> dict[str, Any]:
        """`columns_percent`; `least_bound_m` and `largest_bound_m`, None without one; numbers of frames:
        `without_bound`, `reduced` by choice of returns, and `intensity`, by how it was sent."""
        bounds = [bound for bound in self._bounds if bound is not None]
        return {
            "columns_percent": round(100 * self._sent / self._columns, 2) if self._columns else None,
            "least_bound_m": min(bounds, default=None),
            "largest_bound_m": max(bounds, default=None),
            "without_bound": self._bounds[None],
            "reduced": self._chosen,
            "intensity": dict(self.intensity),
        }


def bounds_text(result: dict[str, Any]) -> str:
    """The bounds for people: `0.004 to 0.084 m`."""
    least, largest = result["least_bound_m"], result["largest_bound_m"]
    if largest is None:
        return "none"
    text = f"{largest:g} m" if least == largest else f"{least:g} to {largest:g} m"
    return text + f"; {result['without_bound']} frames without a bound" * bool(result["without_bound"])


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
