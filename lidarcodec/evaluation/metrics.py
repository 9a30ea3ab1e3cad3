"""Sizes and errors of coded frames, added up frame by frame. Definitions: docs/evaluation.md.

All bits of a message count. `header` is everything outside the sections of planes: header, section heads, checksum,
calibration, motion, weights, pose. A point is a return of the original frame. Errors are along the ray, over returns
that are valid in both frames.

>>> import numpy as np
>>> errors = RangeErrors()
>>> errors.add(np.array([[500, 0, 700]], np.uint16), np.array([[501, 800, 0]], np.uint16))
>>> errors.max_error_m, errors.lost, errors.invented
(0.002, 1, 1)
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarcodec.message import Message, SectionType
from lidarcodec.planes.lattice_section import read_lattice
from lidarcodec.planes.plane_section import read_head
from lidarcodec.planes.plane_sizes import plane_sizes
from lidarcodec.units import RANGE_STEP_M
from lidarcodec.wire import unpack

PEAK_M = 130.0
"""The peak of PSNR: the largest range of the sensor, as in Tu 2016."""

PEAK_INTENSITY = 255

Ranges = npt.NDArray[np.uint16] | npt.NDArray[np.uint32]

PLANE_OF_SECTION: dict[int, str] = {
    SectionType.RANGE: "range",
    SectionType.MASK: "mask",
    SectionType.KEEP: "keep",
    SectionType.INTENSITY: "intensity",
    SectionType.AZIMUTH: "azimuth",
    SectionType.SIDE: "side",
    SectionType.POSITION: "side",
    SectionType.REST: "side",
    SectionType.PLANES: "planes",
    SectionType.CLOUD: "planes",
}


@dataclass
class RangeErrors:
    """Errors of decoded ranges, as sums over frames of any number and width.

    points: returns of the original; lost: returns that are missing after decoding; invented: returns that only the
    decoded frame has; range_step_m: range step of the sensor
    """

    points: int = 0
    lost: int = 0
    invented: int = 0
    compared: int = 0
    max_steps: int = 0
    squared_steps: int = 0
    range_step_m: float = RANGE_STEP_M

    def add(self, original: Ranges, decoded: Ranges) -> None:
        """Compare two range images of one shape; 0 = no return."""
        there, back = original > 0, decoded > 0
        both = there & back
        difference = np.abs(original[both].astype(np.int64) - decoded[both].astype(np.int64))
        self.points += int(np.count_nonzero(there))
        self.lost += int(np.count_nonzero(there & ~back))
        self.invented += int(np.count_nonzero(back & ~there))
        self.compared += len(difference)
        self.max_steps = max(self.max_steps, int(difference.max(initial=0)))
        self.squared_steps += int(np.dot(difference, difference))

    def merge(self, other: RangeErrors) -> None:
        """Add the counts of `other`."""
        self.points += other.points
        self.lost += other.lost
        self.invented += other.invented
        self.compared += other.compared
        self.max_steps = max(self.max_steps, other.max_steps)
        self.squared_steps += other.squared_steps

    @property
    def max_error_m(self) -> float | None:
        """Largest error; None if nothing could be compared."""
        return round(self.max_steps * self.range_step_m, 6) if self.compared else None

    @property
    def rmse_m(self) -> float | None:
        """Root of the mean squared error; None if nothing could be compared."""
        return math.sqrt(self.squared_steps / self.compared) * self.range_step_m if self.compared else None

    @property
    def psnr_db(self) -> float | None:
        """PSNR over a peak of 130 m; None if there is no error (it would be infinite)."""
        rmse_m = self.rmse_m
        return 20 * math.log10(PEAK_M / rmse_m) if rmse_m else None


@dataclass
class IntensityErrors:
    """Errors of decoded intensities, over returns that are valid in both frames. Intensities that are not sent are
    0.
    """

    compared: int = 0
    squared: int = 0
    largest: int = 0
    total: int = 0

    def add(self, original: npt.NDArray[Any], decoded: npt.NDArray[Any], both: npt.NDArray[np.bool_]) -> None:
        """Compare two intensity images of one shape where `both` is true."""
        difference = original[both].astype(np.int64) - decoded[both].astype(np.int64)
        self.compared += len(difference)
        self.squared += int(np.dot(difference, difference))
        off = np.abs(difference)
        self.largest, self.total = max(self.largest, int(off.max(initial=0))), self.total + int(off.sum())

    def result(self) -> dict[str, float | None]:
        """`intensity_rmse` (of 255), None if nothing could be compared; `intensity_psnr_db`, None without errors."""
        if not self.compared:
            return {"intensity_rmse": None, "intensity_psnr_db": None}
        rmse = math.sqrt(self.squared / self.compared)
        psnr = round(20 * math.log10(PEAK_INTENSITY / rmse), 4) if rmse else None
        return {"intensity_rmse": round(rmse, 4), "intensity_psnr_db": psnr}


@dataclass
class Sizes:
    """Bytes of messages, by plane."""

    total: int = 0
    planes: Counter[str] = field(default_factory=Counter)

    def add(self, message: Message, total: int) -> None:
        """Count a message that took `total` bytes on the wire."""
        self.total += total
        for section in message.sections:
            plane = PLANE_OF_SECTION.get(section.type)
            if plane is not None:
                self.planes[plane] += len(section.data)
            if section.type == SectionType.PLANES:
                self._split(message, section.data)

    def _split(self, message: Message, section: bytes) -> None:
        """Count the images of another sensor than an HDL-64E by what they are, as far as the section tells."""
        columns = message.width
        if message.has(SectionType.LATTICE):
            columns = len(read_lattice(message.section(SectionType.LATTICE)).columns)
        sizes = plane_sizes(section, columns)
        if sizes is None:
            return
        for form in read_head(section).forms:
            self.planes["intensity" if form.role == "attribute" else "range"] += sizes[form.name]
        self.planes["planes"] -= sum(sizes.values())

    def bits_per(self, points: int) -> dict[str, float | None]:
        """Bits of each part for each of `points` points; all None if there are no points.

        `planes`: images that are coded in one stream. What they are made of is then not known: range, mask, geometry
        and intensity are None. Of other sensors than an HDL-64E the mask is in the range, and the intensity is that of
        all attributes.
        """
        planes = self.planes
        geometry = planes["range"] + planes["mask"] + planes["keep"]
        other = self.total - geometry - planes["intensity"] - planes["azimuth"] - planes["side"]
        other -= 0 if geometry else planes["planes"]
        sizes = {
            "range": planes["range"],
            "mask": planes["mask"],
            "geometry": geometry,
            "intensity": planes["intensity"],
            "azimuth": planes["azimuth"],
            "side": planes["side"],
            "header": other,
            "total": self.total,
            **({"planes": planes["planes"]} if planes["planes"] and not geometry else {}),
        }
        bits = {name: round(size * 8 / points, 6) if points else None for name, size in sizes.items()}
        if planes["planes"] and not geometry:
            bits |= dict.fromkeys(("range", "mask", "geometry", "intensity"))
        return bits


def bits_per_point(messages: Iterable[bytes], points: int) -> dict[str, float | None]:
    """Bits of messages for each of `points` returns, everything counted: `range`, `mask`, `geometry` (range and mask),
    `intensity`, `azimuth`, `side`, `header` and `total`, as `lidarcodec bench` prints them.

    points: returns of the frames before they were encoded, `sum(frame.points for frame in frames)`. All are None for 0
    Raises DecodeError for bytes that are no message.
    """
    sizes = Sizes()
    for data in messages:
        sizes.add(unpack(data), len(data))
    return sizes.bits_per(points)


def times_ms(seconds: list[float]) -> dict[str, float | None]:
    """Mean, median and 99th percentile of times, in milliseconds; all None if there are no times."""
    if not seconds:
        return {"mean": None, "p50": None, "p99": None}
    ms = np.array(seconds) * 1e3
    p50, p99 = np.percentile(ms, [50, 99])
    return {"mean": round(float(ms.mean()), 3), "p50": round(float(p50), 3), "p99": round(float(p99), 3)}
