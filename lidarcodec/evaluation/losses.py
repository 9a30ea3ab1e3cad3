"""Losses: what a recording does not give back of the frames that were encoded, counted while they are compared.

>>> Losses().text()
''
"""

from __future__ import annotations

import numpy as np

from lidarcodec.filling import measured_only
from lidarcodec.frame import Frame


class Losses:
    """Over all frames: the share of returns that come back, the largest error of a range, and the error of
    intensities.

    given, kept: numbers of returns; largest_error_m: metres
    """

    def __init__(self) -> None:
        self.given = self.kept = 0
        self.largest_error_m = 0.0
        self._squares = self._compared = 0.0
        self._dark = True

    @property
    def kept_percent(self) -> float:
        """Returns that come back, in percent."""
        return 100 * self.kept / self.given if self.given else 100.0

    @property
    def intensity_rms(self) -> float:
        """Root mean square of the errors of intensities, in units of the sensor."""
        return float(np.sqrt(self._squares / self._compared)) if self._compared else 0.0

    def compare(self, sent: Frame, decoded: Frame) -> None:
        """Add a frame as it was sent, with the returns that a reduction left, and as it comes back. Cost: 2 ms."""
        came = measured_only(decoded)
        self.kept += came.points
        if sent.range.shape != came.range.shape or sent.sensor.is_cloud:
            return
        both = came.valid & sent.valid
        apart = np.abs(sent.range[both].astype(np.int64) - came.range[both])
        self.largest_error_m = max(self.largest_error_m, float(apart.max(initial=0)) * sent.sensor.range_step_m)
        off = sent.intensity[both].astype(np.float64) - came.intensity[both]
        self._squares += float(off @ off)
        self._compared += len(off)
        self._dark &= not came.intensity.any()

    def text(self) -> str:
        """The losses in a few words, each after a comma; empty if there are none."""
        kept = f", {self.kept_percent:.1f} % of the returns kept" if self.kept < self.given else ""
        far = f", ranges off by at most {self.largest_error_m:.3g} m" if self.largest_error_m > 0 else ""
        off = "left out" if self._dark else f"off by {self.intensity_rms:.1f} (RMS)"
        intensity = f", intensities {off}" if self._squares else ""
        return kept + far + intensity
