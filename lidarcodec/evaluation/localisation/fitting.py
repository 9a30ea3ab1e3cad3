"""Comparison at equal bytes: finds the number of points at which a method's frames have a given size."""

from __future__ import annotations

from typing import Final, Protocol

from lidarcodec.evaluation.localisation.coding import Received
from lidarcodec.evaluation.localisation.methods import Method

TRIES: Final = 4
CLOSE: Final = 0.01
SAMPLE: Final = range(30)
"""Number of consecutive frames."""
FEWEST, MOST = 50, 200_000


class Send(Protocol):
    """Sends a method's frames. wanted: frames to return; only: frames to send"""

    def __call__(self, method: Method, wanted: range, only: range | None = None) -> Received: ...


def fitted(method: Method, send: Send) -> Method:
    """The method with the budget at which a frame has `frame_bytes`, within 1 % over thirty consecutive frames."""
    if method.frame_bytes is None or method.points is None:
        return method
    for _ in range(TRIES):
        size = send(method, range(0), SAMPLE).frame_bytes
        if abs(size / method.frame_bytes - 1) < CLOSE:
            break
        wanted = round(method.points * method.frame_bytes / max(size, 1.0))
        method = method.with_points(min(max(wanted, FEWEST), MOST))
    return method
