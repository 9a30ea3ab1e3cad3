"""What verify compares beside the ranges of first returns: second returns, attributes, and points of clouds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidarcodec.errors import DecodeError
from lidarcodec.evaluation.metrics import RangeErrors
from lidarcodec.frame import Frame
from lidarcodec.frame_images import images_of, layout_of
from lidarcodec.packet import Packet
from lidarcodec.planes.attribute_values import AttributeQuality
from lidarcodec.planes.clouds.comparison import point_errors
from lidarcodec.sensors.clouds.message import read_message


@dataclass
class CloudErrors:
    """How far points of clouds are from where they were, in metres, as sums over messages.

    other_fields: messages that differ in more than x, y and z, or in coordinates that are no numbers
    """

    points: int = 0
    max_m: float = 0.0
    squared_m2: float = 0.0
    other_fields: int = 0

    def add(self, given: Sequence[Packet], back: Sequence[Packet], returns: RangeErrors) -> float:
        """Compare messages with those of the recording; returns the largest error. returns: counts those of both

        Images are not compared: which column of it a point has depends on the messages before.
        """
        largest = 0.0
        for one, other in zip(given, back, strict=True):
            there, came = _returns(one.payload), _returns(other.payload)
            if len(there) == len(came):
                returns.add(there, came)
            errors = point_errors(other.payload, one.payload)
            if errors is None or np.isinf(errors).any():
                self.other_fields += 1
                continue
            self.points += len(errors)
            self.squared_m2 += float(np.square(errors).sum())
            largest = max(largest, float(errors.max(initial=0.0)))
        self.max_m = max(self.max_m, largest)
        return largest

    @property
    def rmse_m(self) -> float:
        """Root of the mean squared error."""
        return math.sqrt(self.squared_m2 / max(self.points, 1))


def _returns(payload: bytes) -> npt.NDArray[np.uint16]:
    """(N,) 1 for each point of a message that is a return; (0,) if it is no cloud."""
    try:
        return read_message(payload).returns.astype(np.uint16)
    except DecodeError:
        return np.zeros(0, np.uint16)


def values_difference(
    decoded: Frame, original: Frame, told: AttributeQuality, step: int | None, *, reduced: bool
) -> str | None:
    """What second returns, intensities or further attributes are not as promised, in words; None if all are.

    told: quality of the attributes by the message; only lossless ones are compared. step: of its ranges, None
    if they have no bound; reduced: whether returns were removed
    """
    if original.sensor.is_hdl64e:
        kept = decoded.valid if reduced else np.True_
        same = np.array_equal(original.intensity[kept], decoded.intensity[kept])
        return "other values of intensity" if told.lossless and not same else None
    found = layout_of(original)
    if found is None:
        return None
    given, came = (images_of(frame, found[1]).planes for frame in (original, decoded))
    for form in found[1].planes[1:]:
        attribute = form.role == "attribute"
        if attribute and not told.lossless:
            continue
        there = came[form.of if attribute else form.name] > 0 if reduced else np.True_
        values, image = (planes[form.name][there].astype(np.int64) for planes in (given, came))
        if attribute and not np.array_equal(values, image):
            return f"other values of {form.name}"
        if not attribute and not np.array_equal(values > 0, image > 0):
            return f"other returns in {form.name}"
        if not attribute and step is not None and np.abs(values - image).max(initial=0) > step // 2:
            return f"larger errors of {form.name} than their messages allow"
    return None
