"""Ranges of any sensor as whole numbers for a picture, and which of its other planes say what a picture cannot.

A picture has no holes, and 16 bits or fewer a sample. So beside it travels a plane `range` of small numbers: 0 where
there is no return, else 1, or with codecs that keep a bound 1 more than the bits above the sixteenth. A second range
that equals the first has that small number, too: nearly all do.

>>> forms = (Plane("range", 20, "range"), Plane("range2", 20, "second range"))
>>> planes = {"range": np.array([[0, 5, 70000]], np.uint32), "range2": np.array([[0, 9, 70000]], np.uint32)}
>>> split = split_ranges(forms, planes, 1, exact=True)
>>> split.planes["range"].tolist(), split.planes["range2"].tolist(), split.forms[0].bits
([[0, 1, 2]], [[0, 9, 2]], 5)
>>> join_ranges(split.planes, split.numbers & 0xFFFF, 1, 20, exact=True)["range2"].tolist()
[[0, 9, 70000]]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import SectionError
from lidarcodec.sensors.images import Plane, Unsigned

RANGE: Final = "range"
SECOND: Final = "second range"
SECOND_NAME: Final = "range2"
SAMPLE_BITS: Final = 16

Mask = npt.NDArray[np.bool_]
Numbers = npt.NDArray[np.uint32]


class RangeCells(NamedTuple):
    """What is known of the cells of a frame, (H, W), before their ranges are; W are the columns that are sent.

    known: (H, W) bool, returns; shift: (H,) int32, columns by which rows move so that neighbours look in one direction
    azimuth: (W,) uint16, 0.01 degree; step_m: the sensor's range step; bits: of its ranges, up to 20
    """

    known: Mask
    shift: npt.NDArray[np.int32]
    azimuth: npt.NDArray[np.uint16]
    step_m: float
    bits: int

    @property
    def most(self) -> int:
        """The largest range there can be, in steps."""
        return (1 << self.bits) - 1


class SplitRanges(NamedTuple):
    """numbers: (H, W) uint32, ranges, or with a step their numbers, 0 without a return; forms and planes: of all that
    travels beside the picture"""

    numbers: Numbers
    forms: tuple[Plane, ...]
    planes: dict[str, Unsigned]


def numbers_of(ranges: Unsigned, step: int) -> Numbers:
    """Numbers of ranges with a step, as in docs/wire-format-planes.md: 0 without a return, else at least 1."""
    wide = ranges.astype(np.uint32)
    if step == 1:
        return wide
    numbers: Numbers = np.where(wide > 0, (wide + np.uint32(step // 2)) // np.uint32(step) + np.uint32(1), 0).astype(
        "u4"
    )
    return numbers


def ranges_of(numbers: Numbers, step: int, most: int) -> Numbers:
    """The ranges of numbers, at most `most`."""
    if step == 1:
        return numbers
    exact = np.minimum((numbers.astype(np.int64) - 1) * step, most)
    exact[numbers == 1] = min((step // 2 + 1) // 2, most)
    exact[numbers == 0] = 0
    return exact.astype(np.uint32)


def split_ranges(forms: Sequence[Plane], planes: Mapping[str, Unsigned], step: int, *, exact: bool) -> SplitRanges:
    """What of the planes of a frame is in the picture, and what beside it.

    exact: whether the picture gives the numbers back as they are, up to their 16 lower bits
    """
    numbers = numbers_of(planes[RANGE], step)
    high = np.where(numbers > 0, 1 + (numbers >> np.uint32(SAMPLE_BITS)) * exact, 0).astype(np.uint32)
    beside, told = dict(planes), []
    for given in forms:
        form = given
        if given.role == "range":
            form = given._replace(bits=max(given.bits - SAMPLE_BITS, 0) + 1 if exact else 1)
            beside[form.name] = high.astype(form.dtype)
        elif given.role == SECOND:
            form = given._replace(bits=max(given.bits, forms[0].bits))
            second = numbers_of(planes[form.name], step)
            beside[form.name] = (_swapped(second, numbers, high) if exact else _marked(second, numbers, high)).astype(
                form.dtype
            )
        told.append(form)
    return SplitRanges(numbers, tuple(told), beside)


def join_ranges(
    planes: Mapping[str, Unsigned], samples: npt.NDArray[Any], step: int, bits: int, *, exact: bool
) -> dict[str, Unsigned]:
    """Range planes of a frame out of those beside the picture; the reverse of `split_ranges`.

    samples: (H, W), of the picture: the lower 16 bits of numbers, or ranges; anything where there is no return
    Raises SectionError for a number that no range of so many bits has.
    """
    high = planes[RANGE].astype(np.uint32)
    most = (1 << bits) - 1
    if not exact:
        first = np.where(high > 0, np.clip(samples, 1, most), 0).astype(np.uint32)
    else:
        first = np.where(high > 0, samples.astype(np.uint32) | (high - np.uint32(1)) << np.uint32(SAMPLE_BITS), 0)
        _check(first, high > 0, step, most)
    found: dict[str, Unsigned] = {RANGE: ranges_of(first, step, most)}
    second = planes.get(SECOND_NAME)
    if second is not None:
        wide = second.astype(np.uint32)
        if exact:
            numbers = _swapped(wide, first, high)
            _check(numbers, numbers > 0, step, most)
        else:
            numbers = np.where((high > 0) & (wide == high), first, wide)
        found[SECOND_NAME] = ranges_of(numbers, step, most).astype(second.dtype)
    return found


def check_second(forms: Sequence[Plane]) -> None:
    """Whether second ranges, and nothing else, have their name. Raises SectionError."""
    for form in forms:
        if (form.role == SECOND) != (form.name == SECOND_NAME):
            raise SectionError(f"a picture beside a plane '{form.name}' in the role of {form.role}")


def _check(numbers: Numbers, returns: Mask, step: int, most: int) -> None:
    top = most if step == 1 else 1 + (most + step // 2) // step
    if np.any(numbers[returns] == 0) or int(numbers.max(initial=0)) > top:
        raise SectionError(f"a picture with a range number beyond 1 to {top}")


def _swapped(second: Numbers, first: Numbers, high: Numbers) -> Numbers:
    """Numbers of second returns: that of the first and the small one change places. Twice is as before."""
    return np.where(second == first, high, np.where(second == high, first, second))


def _marked(second: Numbers, first: Numbers, high: Numbers) -> Numbers:
    """The same where first ranges are not exact: 1 is the first one again, and a second one of 1 step is sent as 2."""
    own = np.where((high > 0) & (second == 1), np.uint32(2), second)
    return np.where((second == first) & (high > 0), high, own)
