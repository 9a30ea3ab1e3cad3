"""CodingLosses: what coding took from the frames that came over a network, as far as a receiver can know it.

Bounds, columns and how intensities were sent stand in the messages; `lidarcodec info` tells the same of their
recording. How many returns another reduction left stands only in the vehicle's status. A receiver has no originals, so
it compares nothing.

>>> losses = CodingLosses()
>>> losses.told({"reduction": {"name": "random:0.5", "returns": 1000, "kept": 497}})
>>> losses.text()
', about 49.7 % of the returns sent'
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Final

from lidarcodec.errors import DecodeError
from lidarcodec.evaluation.sent import FEW, OFF, UNSAID, Sent
from lidarcodec.layers import is_refinement
from lidarcodec.settings import LATTICE
from lidarcodec.units import counted
from lidarcodec.wire import unpack

WAYS: Final = {OFF: "left out", FEW: FEW, UNSAID: "not said to be whole"}
"""Intensities that may not all have come, in words."""


class CodingLosses:
    """Over all messages of a stream that came. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sent = Sent()
        self._returns = self._kept = 0
        self._status: Mapping[str, Any] | None = None

    def came(self, data: bytes) -> None:
        """Add a message, packed by `wire.pack`. Refinements, and what is damaged, are passed over."""
        if not is_refinement(data):
            with suppress(DecodeError), self._lock:
                self._sent.add(unpack(data))

    def told(self, status: Mapping[str, Any] | None) -> None:
        """Add what a status says of a reduction, unless it was the last one, too. Columns are counted in the messages.
        Fields of other versions are left out."""
        if status is None or status is self._status:
            return
        self._status, reduction = status, status.get("reduction")
        if not isinstance(reduction, Mapping):
            return
        returns, kept = reduction.get("returns"), reduction.get("kept")
        columns = str(reduction.get("name")).partition(":")[0] == LATTICE
        if not columns and isinstance(returns, int) and isinstance(kept, int) and 0 <= kept <= returns:
            self._returns += returns
            self._kept += kept

    def values(self) -> dict[str, Any]:
        """All of it as plain values: those of `Sent`, and `returns_percent`, the share of returns that was sent."""
        with self._lock:
            found = self._sent.result()
        return {"returns_percent": self._returns_percent(found), **found}

    def text(self) -> str:
        """The losses in a few words, each after a comma; empty if there are none, or none are known."""
        found = self.values()
        percent, largest_m, unbounded = (found[one] for one in ("returns_percent", "largest_bound_m", "without_bound"))
        kept = f", about {percent:.1f} % of the returns sent" if percent is not None and percent < 99.95 else ""
        if found["reduced"] and not self._returns:
            kept = ", not all returns sent"  # how many, only a status says
        far = [f"by at most {largest_m:g} m"] if largest_m else []
        far += ["by no known bound"] if unbounded and largest_m is None else []
        far += [f"in {counted(unbounded, 'frame')} by no known bound"] if unbounded and largest_m is not None else []
        return kept + f", ranges off {', '.join(far)}" * bool(far) + _intensity_text(found["intensity"])

    def _returns_percent(self, found: Mapping[str, Any]) -> float | None:
        """As if every column had as many returns; None before the first message. Statuses tell the share of frames of
        which a reduction chose returns, and messages how many frames those are; `raw` does not say that.

        found: as of `Sent`
        """
        share = self._kept / self._returns if self._returns else 1.0
        if found["columns_percent"] is None:
            return round(100.0 * share, 2) if self._returns else None
        said = sum(found["intensity"].values()) - found["intensity"].get(UNSAID, 0)
        chosen: float = found["reduced"] / said if said else 1.0
        columns: float = found["columns_percent"]
        return round(columns * (1.0 - chosen * (1.0 - share)), 2)


def _intensity_text(frames: Mapping[str, int]) -> str:
    total, lossy = sum(frames.values()), [(text, frames[way]) for way, text in WAYS.items() if frames.get(way)]
    if not lossy:
        return ""
    if lossy[0][1] == total:
        return f", intensities {lossy[0][0]}"
    return f", intensities {' and '.join(f'{text} in {number}' for text, number in lossy)} of {counted(total, 'frame')}"
