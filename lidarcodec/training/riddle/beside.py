"""Samples of a drive with the predictions of the context models for each return.

A network that is trained alone learns much that context models also predict. If it is then trained together with
them, it uses its weights for the rest.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec.entropy import PredictiveCoder, ReturnSamples, columns_in_turn
from lidarcodec.frame import Frame
from lidarcodec.motion.finder import MotionFinder
from lidarcodec.motion.warp import RangeHistory
from lidarcodec.network.networks import Net
from lidarcodec.network.shelf import native_nets
from lidarcodec.ranges.firings import FiringCounter
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.ranges.quantise import as_decoded
from lidarcodec.training.riddle.extraction import Rows, joined, rows_of

_WARM: Final = 5
"""Number of frames in which context models adapt; these frames give no samples."""


class BesideSamples:
    """Codes the frames of a drive in order, and keeps some returns of each.

    nets: both networks of the codec; step: odd quantiser step; rows: most samples of each frame
    """

    def __init__(self, nets: list[Net], step: int, rows: int, rng: np.random.Generator) -> None:
        self._step, self._rows, self._rng = step, rows, rng
        self._coders = {expects: PredictiveCoder(nets=native_nets(nets)) for expects in (False, True)}
        self._history, self._finder, self._firings = RangeHistory(), MotionFinder(), FiringCounter()
        self._seen = 0

    def of(self, frames: Iterable[Frame]) -> tuple[Rows, Rows]:
        """Rows of the frames coded as key frames, and of the same frames coded with expected ranges."""
        found: dict[bool, list[Rows]] = {False: [], True: []}
        for frame in frames:
            motion = self._finder.next(frame, self._history).motion
            expected = self._history.expected(motion, frame.azimuth, frame.fired, frame.sensor) if self._seen else None
            self._coders[False].reset()
            found[False] += self._coded(frame, None)
            if expected is not None:
                found[True] += self._coded(frame, expected)
            sent = as_decoded(frame.range_u16, frame.valid, self._step, level_offsets(frame.sensor))
            self._history.remember(sent, frame.azimuth, frame.fired, frame.sensor)
            self._seen += 1
        return joined(found[False], expects=False), joined(found[True], expects=True)

    def _coded(self, frame: Frame, expected: npt.NDArray[np.uint16] | None) -> list[Rows]:
        warm = expected is None or self._seen >= _WARM
        kept = ReturnSamples(self._rows / max(1, frame.points) if warm else 0, int(self._rng.integers(1 << 32)))
        self._coders[expected is not None].encode(
            frame.range_u16, frame.valid, frame.fired, frame.sensor, self._step, level_offsets(frame.sensor),
            turn=columns_in_turn(frame.azimuth) if frame.fired.all() else None,
            firing=self._firings.columns_before(frame), expected=expected, samples=kept,
        )  # fmt: skip
        return [rows_of(*kept.taken())] if len(kept) else []
