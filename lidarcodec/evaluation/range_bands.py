"""Quantiles of the error along the ray, by range: a mean over all ranges hides large errors of near or far returns.

>>> bands = RangeBands()
>>> bands.add(np.array([[1000, 1000, 1000, 30_000]], np.uint16), np.array([[1000, 1001, 1005, 30_010]], np.uint16))
>>> [(band["from_m"], band["returns"], band["p50_m"], band["max_m"]) for band in bands.result() if band["returns"]]
[(0.0, 3, 0.002, 0.01), (40.0, 1, 0.02, 0.02)]
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.units import RANGE_STEP_M

EDGES_M: Final = (0.0, 10.0, 20.0, 40.0, 80.0, 131.07)
"""Limits of the bands; 131.07 m is the largest range in 16 bits."""
QUANTILES: Final = {"p50_m": 0.5, "p90_m": 0.9, "p99_m": 0.99}
_BANDS: Final = len(EDGES_M) - 1
_VALUES: Final = 1 << 16


class RangeBands:
    """Histograms of the error in range steps, for each band of the original range. They give exact quantiles over any
    number of frames, and take 2.6 MB."""

    def __init__(self) -> None:
        self._counts: npt.NDArray[np.int64] = np.zeros((_BANDS, _VALUES), np.int64)
        edges = np.round(np.array(EDGES_M[1:-1]) / RANGE_STEP_M).astype(np.int64)
        self._band_of = np.searchsorted(edges, np.arange(_VALUES), side="right").astype(np.uint8)

    def add(self, original: npt.NDArray[np.unsignedinteger], decoded: npt.NDArray[np.unsignedinteger]) -> None:
        """Count the errors of two range images of one shape, where both have a return; 0 = no return."""
        both = (original > 0) & (decoded > 0)
        was = original[both]
        error = np.abs(was.astype(np.int32) - decoded[both].astype(np.int32))
        band = self._band_of[was]
        for number in range(_BANDS):
            found = np.bincount(error[band == number])
            self._counts[number, : len(found)] += found

    def result(self) -> list[dict[str, Any]]:
        """A mapping for each band: `from_m`, `to_m`, `returns`, and the quantiles and the largest error in metres.

        A quantile is the smallest error that at least this share of the returns does not exceed; None without returns.
        """
        return [self._of(number) for number in range(_BANDS)]

    def _of(self, number: int) -> dict[str, Any]:
        counts = self._counts[number]
        total = int(counts.sum())
        out: dict[str, Any] = {"from_m": EDGES_M[number], "to_m": EDGES_M[number + 1], "returns": total}
        if not total:
            return out | dict.fromkeys((*QUANTILES, "max_m"))
        upto = np.cumsum(counts)
        for name, share in QUANTILES.items():
            out[name] = round(int(np.searchsorted(upto, share * total)) * RANGE_STEP_M, 6)
        return out | {"max_m": round(int(np.flatnonzero(counts)[-1]) * RANGE_STEP_M, 6)}
