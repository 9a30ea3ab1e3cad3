"""Equal bytes: how many points a method may send so that its frames take a given size."""

from __future__ import annotations

from typing import Final, Protocol

from lidarcodec.evaluation.localisation.coding import Received
from lidarcodec.evaluation.localisation.methods import Method

TRIES: Final = 4
CLOSE: Final = 0.01
SAMPLE: Final = range(30)
"""Frames in a row."""
FEWEST, MOST = 50, 200_000


class Send(Protocol):
    """Sends a method's frames: those that are kept, those that are sent at all."""

    def __call__(self, method: Method, wanted: range, only: range | None = None) -> Received: ...


def fitted(method: Method, send: Send) -> Method:
    """The method with the budget at which a frame takes `frame_bytes`, within 1 % on thirty frames in a row."""
    if method.frame_bytes is None or method.points is None:
        return method
    for _ in range(TRIES):
        size = send(method, range(0), SAMPLE).frame_bytes
        if abs(size / method.frame_bytes - 1) < CLOSE:
            break
        wanted = round(method.points * method.frame_bytes / max(size, 1.0))
        method = method.with_points(min(max(wanted, FEWEST), MOST))
    return method
