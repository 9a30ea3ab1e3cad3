"""The first two bytes of a RANGE section of the bounded codecs: the quantiser step, u16."""

from __future__ import annotations

from lidarcodec.errors import SectionError
from lidarcodec.ranges.quantise import check_step


def with_step(step: int, data: bytes) -> bytes:
    """The section: step and data."""
    return check_step(step).to_bytes(2, "little") + data


def split_step(data: bytes) -> tuple[int, bytes]:
    """Step and data of the section.

    Raises SectionError.
    """
    if len(data) < 2:
        raise SectionError(f"a range section of {len(data)} bytes has no step")
    return check_step(int.from_bytes(data[:2], "little")), data[2:]
