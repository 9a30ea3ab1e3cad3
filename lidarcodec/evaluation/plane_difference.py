"""What of a decoded frame of another sensor than an HDL-64E is not as its settings promise."""

from __future__ import annotations

from typing import Final

import numpy as np

from lidarcodec.codecs.plane_content import sent_planes
from lidarcodec.frame import Frame
from lidarcodec.frame_images import layout_of
from lidarcodec.message import Message, SectionType
from lidarcodec.planes.attribute_values import AttributeQuality
from lidarcodec.planes.plane_section import read_head
from lidarcodec.sensors.images import Unsigned

FEW: Final = 256


def told_of_planes(message: Message) -> AttributeQuality:
    """What a message tells of its attributes: all, none, or few values; of these not how many.

    Raises SectionError or TruncatedError.
    """
    if not message.has(SectionType.PLANES):
        return AttributeQuality()
    head = read_head(message.section(SectionType.PLANES))
    if head.tables:
        return AttributeQuality(FEW)
    return AttributeQuality(None if any(form.role == "attribute" for form in head.forms) else 0)


def plane_difference(
    came: Frame, sent: Frame, quality: AttributeQuality, allowed: int | None, *, exact: bool = True
) -> str | None:
    """In words; None: all is as promised.

    quality: of the attributes; allowed: the largest error of a range, in range steps, None if there is no bound
    exact: whether the encoder chose values with this very quality
    """
    found = layout_of(sent)
    if found is None:
        return None
    promised = sent_planes(sent, found[1], quality)
    planes = {"range": came.range, "intensity": came.intensity, **came.planes}
    if any(form.name not in planes for form in promised.forms):
        return "fewer planes"
    images = {name: image if sent.lattice is None else image[:, sent.lattice] for name, image in planes.items()}
    for form in promised.forms:
        image, values = images[form.name], promised.planes[form.name]
        if form.role != "attribute":
            if not np.array_equal(image > 0, values > 0):
                return f"other returns in {form.name}"
            if allowed is not None and _largest_error(image, values) > allowed:
                return f"larger errors of {form.name} than are allowed"
        elif (exact or form.name not in promised.tables) and not np.array_equal(image, values):
            return f"different values of {form.name} than were chosen"
    if quality.off and came.intensity.any():
        return "intensities, although they are off"
    given = sent_planes(sent, found[1], AttributeQuality()).planes
    for name in {form.name.removesuffix("2") for form in promised.forms if form.name in promised.tables}:
        alike = [
            (form.name, promised.planes[form.of] > 0) for form in promised.forms if form.name in (name, f"{name}2")
        ]
        values, image = (np.concatenate([of[one][where] for one, where in alike]) for of in (given, images))
        if not exact and _too_far(image, values):
            return f"larger errors of {name} than any choice of values allows"
    return None


def _largest_error(image: Unsigned, values: Unsigned) -> int:
    return int(np.abs(image.astype(np.int64) - values.astype(np.int64)).max(initial=0))


def _too_far(came: Unsigned, given: Unsigned) -> bool:
    """Whether errors are larger than those of any choice of values: those of one, the mean as an integer."""
    off = came.astype(np.float64) - given
    return bool(off.size) and float(np.square(off).mean()) > float(given.astype(np.float64).var()) + 0.25
