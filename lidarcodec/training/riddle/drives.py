"""Drives for training: simulated drives of many kinds, and any source, divided into clips.

A clip is a few frames at equal distances. Distance 1 is the drive itself; 2 and more are like a faster drive, or like a
stream with skipped frames.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Final

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.pipeline import frames_of
from lidarcodec.sources.base import Source
from lidarcodec.sources.simulator import LABELS, SimulatorSource
from lidarcodec.training.riddle.beams import MOST_FRAMES, even_frames
from lidarcodec.units import FRAME_PACKETS

DISTANCES: Final = (1, 1, 1, 1, 1, 1, 2, 3, 5)
"""Distances of frames in a clip; a distance that occurs more often here is chosen more often."""
CLIP_FRAMES: Final = 4
"""Frames in a clip: two determine the motion of the sensor, the others give samples."""
DRIVE_FRAMES: Final = (CLIP_FRAMES - 1) * max(DISTANCES) + 1
"""Frames of a simulated drive: one clip at the largest distance, or several at smaller ones."""
_SCENES: Final = (*("city",) * 10, "road", "street")
_SPEEDS: Final = (1, 3, 5, 8, 14, 20, 28)
_TRAFFIC: Final = (0.3, 0.7, 1, 1, 1.5, 2)
_ANYHOW, _FOR_VEGETATION = 0.08, 6.0
"""Probability of using a drive, and its increase with the share of returns on leaves."""
_OWN_SPEED: Final = 0.75
"""Share of drives at the usual speed of their scene, including stops at crossings."""


def simulated_drives(count: int, seed: int) -> Iterator[str]:
    """Names of sources: simulated drives of every scene, each through a different town.

    Leaves and grass are rarer in these towns than on real drives, and they are expensive to code. So drives that begin
    near many of them are preferred. Checking one takes a twentieth of a second.
    """
    rng = np.random.default_rng([seed, 0x51])
    for _ in range(count):
        while True:
            drive = _drawn(rng)
            if rng.random() < _ANYHOW + _FOR_VEGETATION * _vegetation(drive):
                break
        yield drive


def _drawn(rng: np.random.Generator) -> str:
    options = f"seed={rng.integers(1, 10**6)}&skip={rng.integers(0, 600)}&traffic={rng.choice(_TRAFFIC):g}"
    speed = "" if rng.random() < _OWN_SPEED else f"&speed={rng.choice(_SPEEDS)}"
    return f"sim:{rng.choice(_SCENES)}?{options}{speed}&frames={DRIVE_FRAMES}"


def _vegetation(drive: str) -> float:
    """Share of leaves among a drive's first returns."""
    source = SimulatorSource.from_spec(drive)
    assert isinstance(source, SimulatorSource)
    labels = source.truth(FRAME_PACKETS)[2]
    leaves, all_of_them = np.count_nonzero(labels == LABELS.index("vegetation")), np.count_nonzero(labels)
    return float(leaves) / max(1.0, float(all_of_them))


def clips(frames: Iterable[Frame], rng: np.random.Generator) -> Iterator[list[Frame]]:
    """Successive clips of a drive. The rest at its end is a clip with distance 1. At most 16 frames are in memory."""
    wanted = int(rng.choice(DISTANCES))
    held: list[Frame] = []
    for frame in frames:
        held.append(frame.with_(side=None))
        if len(held) == (CLIP_FRAMES - 1) * wanted + 1:
            yield held[::wanted]
            held, wanted = [], int(rng.choice(DISTANCES))
    if held:
        yield held[:CLIP_FRAMES]


def frames_to_learn(source: Source, framing: str, frames: int | None = None) -> Iterator[Frame]:
    """Frames of a source; frames of a simulated drive are made like those of a real sensor (see `beams`).

    frames: most frames. Raises errors of the source, and SourceError for a simulated drive of over 287 frames.
    """
    if isinstance(source, SimulatorSource):
        only = None if source.only is None else -(-source.only // FRAME_PACKETS)
        given = [count for count in (source.frames, only, frames) if count is not None]
        return even_frames(source, framing, min(given, default=MOST_FRAMES))
    return islice(frames_of(source.packets(), source.sensor, framing), frames)
