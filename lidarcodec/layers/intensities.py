"""Intensities of a sector: an INTENSITY section of its columns, in the forms 3 and 4 of docs/wire-format.md."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec import entropy
from lidarcodec.entropy.zstd_frames import decompress
from lidarcodec.errors import SectionError, TruncatedError
from lidarcodec.frame import Frame
from lidarcodec.planes.intensity import (
    FORM_ALL_FIRED,
    FORM_RETURNS,
    LOSSLESS_LEVELS,
    MODELLED,
    Quality,
    encode_intensity,
)
from lidarcodec.planes.sections import fired_cells

_SIZE = 4


def encode_exact(part: Frame, turn: int) -> bytes:
    """The section: every intensity of the fired cells. part: the sector's columns; turn: columns in a turn, or 0"""
    coded = encode_intensity(part, fired_cells(part.fired, part.sensor), Quality(LOSSLESS_LEVELS), turn=turn or None)
    return b"" if coded is None else coded


def decode_exact(data: bytes, base: Frame) -> npt.NDArray[np.uint8]:
    """(64, W) uint8, the intensities of the sector's columns. base: these columns, with the returns

    Raises SectionError or TruncatedError.
    """
    form, at = data[0] if data else -1, 1
    if form not in (MODELLED + FORM_RETURNS, MODELLED + FORM_ALL_FIRED):
        raise SectionError(f"intensities of a refinement have form 3 or 4, not {form}")
    end = len(data)
    if form == MODELLED + FORM_ALL_FIRED:
        at += _SIZE
        end = at + int.from_bytes(data[1:at], "little")
        if end > len(data):
            raise TruncatedError("intensities end before what they announce", len(data))
    image = entropy.decode_intensity(data[at:end], base.valid, base.fired, base.sensor)
    if form == MODELLED + FORM_ALL_FIRED:
        others = fired_cells(base.fired, base.sensor) > base.valid
        rest = decompress(data[end:], int(np.count_nonzero(others)))
        image[others] = np.frombuffer(rest, np.uint8)
    return image
