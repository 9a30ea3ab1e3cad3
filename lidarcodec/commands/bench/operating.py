"""`bench --curve --metrics all`: points of operating curves, with the accuracy of localisation at each.

The drive is read once, and its reference is computed once for all points.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from lidarcodec.errors import LidarCodecError
from lidarcodec.evaluation.bench import bench
from lidarcodec.evaluation.localisation.cache import Cache
from lidarcodec.evaluation.localisation.evaluate import Evaluation, Options
from lidarcodec.evaluation.localisation.methods import Method
from lidarcodec.settings import StreamSettings

FIELDS = ("mate_m", "mate_m_error", "bad", "of")


class OperatingPoints:
    """Measures settings on one source. poses: file of poses, if given"""

    def __init__(self, poses: Path | None) -> None:
        self._poses = poses
        self._evaluation: Evaluation | None = None
        self._failed = False

    def bench(self, source: str, *, settings: StreamSettings, **given: Any) -> dict[str, Any]:
        """As `bench`, and `localisation` for the protocol `near`: the mean position error (`mate_m`) with its standard
        error, the number of scans (`of`), and the number of scans that were not located (`bad`); None if the drive is
        too short or has no reference trajectory."""
        result = bench(source, settings, **given)
        tick = given.pop("tick")
        del given["unkept"]
        return {**result, "localisation": self._localisation(source, settings, tick=tick, **given)}

    def _localisation(self, source: str, settings: StreamSettings, **given: Any) -> dict[str, Any] | None:
        if self._failed:
            return None
        named = ("frames", "skip", "calibration", "tick")
        try:
            if self._evaluation is None:
                options = {name: given[name] for name in named}
                self._evaluation = Evaluation(
                    source, Options(protocols=("near",)), Cache(None), poses=self._poses, **options
                )
            (found,) = self._evaluation.method(Method(settings.reduction, settings))
        except LidarCodecError as error:
            print(f"localisation cannot be measured: {error}", file=sys.stderr)
            self._failed = True
            return None
        near = found.result["near"]
        return {name: near[name] for name in FIELDS} if near["of"] else None
