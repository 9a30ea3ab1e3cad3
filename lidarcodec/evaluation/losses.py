"""Losses: what a recording does not give back of the frames that were encoded, counted while they are compared.

>>> Losses().text()
''
"""

from __future__ import annotations

from lidarcodec.evaluation.metrics import IntensityErrors, RangeErrors
from lidarcodec.filling import measured_only
from lidarcodec.frame import Frame
from lidarcodec.planes.clouds.comparison import point_errors
from lidarcodec.sensors.clouds.points import payload_of


class Losses:
    """Over all frames: the returns that come back, the largest error of a range or of a point, and the error of
    intensities. given, kept: numbers of returns
    """

    def __init__(self) -> None:
        self.given = self.kept = 0
        self.largest_error_m = 0.0
        self._intensity, self._dark = IntensityErrors(), True

    @property
    def kept_percent(self) -> float:
        """Returns that come back, in percent."""
        return 100 * self.kept / self.given if self.given else 100.0

    @property
    def intensity_rms(self) -> float:
        """Root mean square of the errors of intensities, in units of the sensor."""
        return self._intensity.result()["intensity_rmse"] or 0.0

    def texts(self, left_out: int) -> dict[str, str]:
        """The same for a recording's own notes. left_out: frames that were not encoded"""
        return {
            "returns_percent": f"{self.kept_percent:.2f}",
            "largest_error_m": f"{self.largest_error_m:g}",
            "intensity_rms": f"{self.intensity_rms:.2f}",
            "left_out": str(left_out),
        }

    def compare(self, sent: Frame, decoded: Frame) -> None:
        """Add a frame as it was sent, with the returns that a reduction left, and as it comes back. Cost: 2 ms."""
        came = measured_only(decoded)
        self.kept += came.points
        if sent.sensor.is_cloud:
            errors = point_errors(payload_of(sent), payload_of(decoded))
            off = None if errors is None else float(errors.max(initial=0.0))
        elif sent.range.shape == came.range.shape:
            ranges = RangeErrors(range_step_m=sent.sensor.range_step_m)
            ranges.add(sent.range * sent.valid, came.range * came.valid)
            off = ranges.max_error_m
            self._intensity.add(sent.intensity, came.intensity, sent.valid & came.valid)
            self._dark &= not came.intensity.any()
        else:
            off = None
        self.largest_error_m = max(self.largest_error_m, off or 0.0)

    def text(self) -> str:
        """The losses in a few words, each after a comma; empty if there are none."""
        kept = f", {self.kept_percent:.1f} % of the returns kept" if self.kept < self.given else ""
        far = f", ranges off by at most {self.largest_error_m:g} m" if self.largest_error_m > 0 else ""
        off = "left out" if self._dark else f"off by {self.intensity_rms:.1f} (RMS)"
        intensity = f", intensities {off}" if self._intensity.squared else ""
        return kept + far + intensity
