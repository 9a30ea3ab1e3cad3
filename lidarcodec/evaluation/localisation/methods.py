"""The methods to compare: a reduction, a codec with its settings, and a budget.

>>> [method.label for method in methods(["all", "voxel"], [StreamSettings(codec="zstd")], [9000])]
['all', 'voxel 9,000']
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lidarcodec.evaluation.localisation.selection import CHOICES
from lidarcodec.pipeline import check
from lidarcodec.reduction.table import reduction
from lidarcodec.settings import StreamSettings


@dataclass(frozen=True)
class Method:
    """reduction: its name; settings: settings of the stream, with the reducer if lidarcodec has it; points: budget of a
    choice that exists only for comparison; frame_bytes: size to which the budget is fitted, None = the budget stays"""

    reduction: str
    settings: StreamSettings
    points: int | None = None
    frame_bytes: int | None = None

    @property
    def label(self) -> str:
        """Name in tables and plots, without the codec."""
        return self.reduction if self.points is None else f"{self.reduction} {self.points:,}"

    def with_points(self, points: int) -> Method:
        """The method with another budget."""
        if self.reduction in CHOICES:
            return replace(self, points=points)
        return replace(self, points=points, settings=self.settings.changed(keep_points=points))


def methods(
    reductions: Sequence[str],
    settings: Sequence[StreamSettings],
    budgets: Sequence[int],
    frame_bytes: int | None = None,
) -> list[Method]:
    """Every reduction with every setting of a codec and, if it has a budget, every budget.

    Raises SettingsError for settings that an encoder would refuse.
    """
    found = []
    for name in reductions:
        for chosen in settings:
            if name in CHOICES:
                found += [Method(name, chosen, points, frame_bytes) for points in budgets]
            elif reduction(name.partition(":")[0]).budgeted:
                reduced = [check(chosen.changed(reduction=name, keep_points=points)) for points in budgets]
                found += [Method(name, each, each.keep_points, frame_bytes) for each in reduced]
            else:
                found.append(Method(name, check(chosen.changed(reduction=name))))
    return found
