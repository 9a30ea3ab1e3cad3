"""Which few values stand for the attributes of other sensors than the HDL-64E: the settings `levels=N` and `error=N`.

N counts on a scale from 0 to 255. Of an attribute of up to 8 bits that is the value itself. Of a wider one of b bits it
is 255 sqrt(v / (2^b - 1)): sensors count photons there, and the spread of a count grows with its square root. A value
stands for the mean of those that it replaces.

>>> scale_of(np.array([0, 80, 255]), 8).tolist(), scale_of(np.array([0, 655, 65_535]), 16).round(1).tolist()
([0.0, 80.0, 255.0], [0.0, 25.5, 255.0])
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.planes.intensity import LOSSLESS_LEVELS
from lidarcodec.sensors.images import QUANTITIES, Plane, Unsigned
from lidarcodec.settings import StreamSettings

TOP: Final = 255
"""End of the scale."""
ROUNDING: Final = 1e-9

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


def scale_of(values: npt.NDArray[Any], bits: int) -> Floats:
    """Where values of an attribute of so many bits are on the scale from 0 to 255; same shape."""
    at: Floats = np.asarray(values, np.float64)
    return at if bits <= 8 else TOP * np.sqrt(at / ((1 << bits) - 1))


class AttributeQuality(NamedTuple):
    """Accuracy of decoded attributes.

    levels: most different values of an attribute in a frame, 0 = off, None = lossless; error: if not 0, the largest
    error on the scale, used instead
    """

    levels: int | None = None
    error: int = 0

    @classmethod
    def of(cls, settings: StreamSettings) -> AttributeQuality:
        """The quality in the settings; `auto` counts as lossless, and so does `levels=256`."""
        levels, error = settings.intensity_levels, settings.intensity_error
        return cls() if levels == LOSSLESS_LEVELS and not error else cls(levels, error)

    @property
    def lossless(self) -> bool:
        """Whether every cell keeps its attributes, one without a return too."""
        return self.levels is None

    @property
    def off(self) -> bool:
        """Whether no attribute is sent."""
        return self.levels == 0


class Groups(NamedTuple):
    """values: (N,) ascending, at most 256; each stands for the values from its `starts` on, up to the next one's."""

    starts: Whole
    values: Whole


class Few(NamedTuple):
    """tables: (N,) ascending, the values that each reduced plane has; planes: all planes, (H, W) each."""

    tables: dict[str, Unsigned]
    planes: dict[str, Unsigned]


def reduced(forms: Sequence[Plane], planes: Mapping[str, Unsigned], quality: AttributeQuality) -> Few:
    """The planes with attributes of few values, which are 0 without a return; first and second returns share a table.

    Attributes that are no quantities, such as `flags`, keep their values: they cost next to nothing.

    planes: (H, W) each, by name; quality: neither off nor lossless. Cost: 2 ms for a plane of 131,072 cells.
    """
    groups: dict[str, Groups] = {}
    tables: dict[str, Unsigned] = {}
    found = dict(planes)
    for form in forms:
        if form.role != "attribute":
            continue
        image, returns = planes[form.name], planes[form.of] > 0
        name = form.name.removesuffix("2")
        if name in QUANTITIES:
            if form.name not in groups:
                alike = [one for one in forms if one.name in (name, f"{name}2") and one.bits == form.bits]
                given = np.concatenate([planes[one.name][planes[one.of] > 0] for one in alike])
                groups |= dict.fromkeys([one.name for one in alike], groups_of(given, form.bits, quality))
            starts, values = groups[form.name]
            tables[form.name] = values.astype(form.dtype)
            image = tables[form.name][np.maximum(np.searchsorted(starts, image, side="right") - 1, 0)]
        found[form.name] = np.where(returns, image, np.zeros((), form.dtype)).astype(form.dtype)
    return Few(tables, found)


def groups_of(values: Unsigned, bits: int, quality: AttributeQuality) -> Groups:
    """The values that stand for these; one at least. values: (M,)."""
    if not len(values):
        return Groups(np.zeros(1, np.int64), np.zeros(1, np.int64))
    counts = np.bincount(values)
    used = np.flatnonzero(counts)
    if quality.error:
        return _within(used, counts[used], bits, quality.error)
    levels = quality.levels or 1
    return Groups(used, used) if len(used) <= levels else _best(used, counts[used], bits, levels)


def _within(used: Whole, counts: Whole, bits: int, error: int) -> Groups:
    """Groups of which every value is at most `error` from the one that stands for it; as few as possible.

    used: (U,) ascending; counts: (U,), how often each occurs
    """
    at = scale_of(used, bits)
    starts, values = [], []
    begin = 0
    while begin < len(used):
        # The largest value near enough to the first one of the group says how far the group may reach.
        reach = _largest(at[begin] + error, bits)
        end = int(np.searchsorted(at, scale_of(np.array([reach]), bits)[0] + error + ROUNDING, side="right"))
        group = slice(begin, end)
        least = _smallest(at[end - 1] - error, bits)
        mean = round(float(np.average(used[group], weights=counts[group])))
        starts.append(int(used[begin]))
        values.append(min(max(mean, least), reach))
        begin = end
    return Groups(np.array(starts), np.array(values))


def _largest(place: float, bits: int) -> int:
    """The largest value of so many bits that is not beyond a place on the scale."""
    top = (1 << bits) - 1
    guess = place if bits <= 8 else (max(place, 0.0) / TOP) ** 2 * top
    return min(math.floor(guess + ROUNDING), top)


def _smallest(place: float, bits: int) -> int:
    """The smallest value of so many bits that is not before a place on the scale."""
    guess = place if bits <= 8 else (max(place, 0.0) / TOP) ** 2 * ((1 << bits) - 1)
    return max(math.ceil(guess - ROUNDING), 0)


def _best(used: Whole, counts: Whole, bits: int, levels: int) -> Groups:
    """So many groups with the least squared error on the scale, of which each whole number is one place.

    Dynamic programming over the places: Wang and Song 2011, "Ckmeans.1d.dp".
    """
    place = np.rint(scale_of(used, bits)).astype(np.int64)
    held = np.unique(place)
    if len(held) > levels:
        weight = np.bincount(place, weights=counts.astype(np.float64), minlength=TOP + 1)[held].astype(np.float64)
        firsts = held[_cut(held.astype(np.float64), weight, levels)]
    else:
        firsts = held
    begins = np.searchsorted(place, firsts)
    ends = np.append(begins[1:], len(used))
    sums, total = np.add.reduceat(used * counts, begins), np.add.reduceat(counts, begins)
    means = np.rint(sums / total).astype(np.int64)
    return Groups(used[begins], np.clip(means, used[begins], used[ends - 1]))


def _cut(at: Floats, weight: Floats, groups: int) -> Whole:
    """(groups,) ascending places in `at` where the groups begin. at, weight: (N,), N above `groups`."""
    count = len(at)
    sums = [np.concatenate([[0.0], np.cumsum(weight * at**power)]) for power in (0, 1, 2)]
    mass, first, second = (total[None, :] - total[:, None] for total in sums)  # of places i to j - 1
    inner = second - first**2 / np.where(mass > 0, mass, 1.0)
    cost = np.where(np.tri(count + 1, k=-1, dtype=bool).T, inner, np.inf)  # only i < j
    best = np.full(count + 1, np.inf)
    best[0] = 0.0
    came = np.zeros((groups, count + 1), np.int64)
    for number in range(groups):
        whole = best[:, None] + cost
        came[number] = np.argmin(whole, axis=0)
        best = whole[came[number], np.arange(count + 1)]
    starts, end = [], count
    for number in reversed(range(groups)):
        end = int(came[number, end])
        starts.append(end)
    return np.array(starts[::-1])
