"""Makes simulated drives like those of a real sensor, with beams between the reported azimuths.

A sensor fires every 48 us and turns evenly, but reports its azimuth in steps of 0.09 degree. The simulator measures
exactly at the reported azimuth. So on a slanting wall its ranges grow twice as much after a step of 0.18 degree as
after one of 0.09 degree; those of a real sensor grow equally. A network would learn to rely on this artefact. So each
range is moved along its surface, by the angle from the reported azimuth to that of an evenly turning beam.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SourceError
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.sources.simulator import MAX_TRUTH, PACKET_NS, SimulatorSource
from lidarcodec.units import AZIMUTH_TURN, FIRINGS_PER_PACKET, FRAME_PACKETS, RANGE_STEP_M

WINDOW: Final = 60
"""Number of firings to each side over which the sensor is assumed to turn evenly."""
MOST_FRAMES: Final = MAX_TRUTH // FRAME_PACKETS
_BENT: Final = 0.15
"""On a surface the range grows equally to both sides, within this share of its growth."""
_LEAST_M: Final = 0.0003
_MOST_STEPS: Final = 200.0

Floats = npt.NDArray[np.float64]


def even_frames(source: SimulatorSource, framing: str, frames: int) -> Iterator[Frame]:
    """Frames of the first 348 times `frames` packets of a simulated drive, measured by evenly turning beams.

    Raises SourceError for more than 287 frames, because they are kept in memory.
    """
    if frames > MOST_FRAMES:
        raise SourceError(f"{source.label}: {frames} frames of one simulated drive: at most {MOST_FRAMES} are possible")
    payloads, distance_m, labels = source.truth(frames * FRAME_PACKETS)
    packets = (Packet(data.tobytes(), source.start_ns + number * PACKET_NS) for number, data in enumerate(payloads))
    found = list(frames_of(packets, source.sensor, framing))
    if sum(frame.width for frame in found) != len(payloads) * FIRINGS_PER_PACKET:
        raise SourceError(f"{source.label}: some columns are not firings")
    turned = np.unwrap(np.concatenate([frame.azimuth[0] for frame in found]).astype(np.float64), period=AZIMUTH_TURN)
    grown = _growth(turned, distance_m.astype(np.float64), labels) * (even_turning(turned) - turned)[:, None]
    steps = np.clip(grown / RANGE_STEP_M, -_MOST_STEPS, _MOST_STEPS)[:, source.sensor.laser_of_ring].T
    first = 0
    for frame in found:
        moved = np.rint(frame.range + steps[:, first : first + frame.width]).clip(1, 65535)
        first += frame.width
        yield frame.with_(range=np.where(frame.range > 0, moved, 0).astype(np.uint16), side=None)


def even_turning(turned: Floats) -> Floats:
    """(N,) azimuths of an evenly turning sensor, from the reported ones; both unwrapped, 0.01 degree.

    A mean over equally many firings to each side, up to 60, so straight lines stay straight; straight lines at the
    ends.
    """
    count = len(turned)
    window = min(WINDOW, (count - 1) // 2)
    if window < 1:
        return turned
    sums = np.concatenate([[0.0], np.cumsum(turned)])
    places = np.arange(count)
    wide = np.minimum(np.minimum(places, count - 1 - places), window)
    even: Floats = (sums[places + wide + 1] - sums[places - wide]) / (2 * wide + 1)
    for first, edge in ((0, places[:window]), (count - 2 * window - 1, places[-window:])):
        fitted = slice(first, first + 2 * window + 1)
        even[edge] = np.polynomial.Polynomial.fit(places[fitted], turned[fitted], 1)(edge)
    return even


def _growth(turned: Floats, distance_m: Floats, labels: npt.NDArray[np.uint8]) -> Floats:
    """(N, 64), growth of ranges in metres for 0.01 degree; 0 where neighbouring beams hit another surface."""
    apart = np.diff(turned)
    apart[apart == 0] = 1.0
    growth = np.diff(distance_m, axis=0) / apart[:, None]
    before, after = growth[:-1], growth[1:]
    there = (distance_m > 0) & (labels > 0)
    same = there[1:-1] & there[:-2] & there[2:] & (labels[1:-1] == labels[:-2]) & (labels[1:-1] == labels[2:])
    smooth = np.abs(before - after) < _BENT * (np.abs(before) + np.abs(after)) + _LEAST_M
    found = np.zeros_like(distance_m)
    found[1:-1] = np.where(same & smooth, (before + after) / 2, 0.0)
    return found
