"""The INTENSITY section: intensities of the returns, and those of the no-return cells if any is not zero.

Forms (docs/wire-format.md). The codecs write modelled bytes (entropy/intensity_coder.py), `zstd` grouped ones
(neighbour.py), which are a fifth larger and take a third of the time; every decoder reads both.

0 returns, grouped; 1 u32 size of the grouped returns, these, and one zstd frame for the fired cells without a return;
2 levels - 1 as u8, grouped level numbers of the returns; 3, 4 and 5 the same with modelled returns.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec import entropy
from lidarcodec.codecs.neighbour import decode_bytes, encode_bytes
from lidarcodec.codecs.zstd_frames import compress, decompress
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.sensor_model import SensorModel

FORM_RETURNS: Final = 0
FORM_ALL_FIRED: Final = 1
FORM_LEVELS: Final = 2
MODELLED: Final = 3
"""What is added to a form whose returns are modelled."""
LOSSLESS_LEVELS: Final = 256
_LEVEL: Final = 3

Bytes = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


def level_of(intensity: Bytes, levels: int) -> Bytes:
    """Number of the nearest of `levels` evenly spaced levels of 0..255, for each intensity."""
    table = (np.arange(256, dtype=np.uint32) * (levels - 1) + 127) // 255
    return table.astype(np.uint8)[intensity]


def intensity_of(level: Bytes, levels: int) -> Bytes:
    """Intensity of each level number.

    Raises SectionError for a number that is no level.
    """
    if not 2 <= levels <= LOSSLESS_LEVELS:
        raise SectionError(f"{levels} intensity levels: 2 to 256 are possible")
    if int(level.max(initial=0)) >= levels:
        raise SectionError(f"intensity level {int(level.max())} of {levels}")
    table = (np.arange(levels, dtype=np.uint32) * 255 + (levels - 1) // 2) // (levels - 1)
    return table.astype(np.uint8)[level]


def encode_intensity(
    frame: Frame, cells: Mask, levels: int, *, turn: int | None = None, grouped: bool = False
) -> bytes | None:
    """Bytes of the section, or None when intensity is off (`levels` 0); 4 ms for 120,000 returns, 1.5 ms if grouped.

    cells: (64, W), those that fired; levels: 256 = lossless; turn: columns in a full turn, as for the mask
    grouped: take forms 0 to 2. Of a reduced frame intensities without a return are not sent.
    """
    if not levels:
        return None
    valid, image = frame.valid, frame.intensity
    if levels < LOSSLESS_LEVELS:
        image = level_of(image, levels)
    coded = (
        encode_bytes(image[valid])
        if grouped
        else entropy.encode_intensity(image, valid, frame.fired, frame.sensor, turn=turn)
    )
    kind = 0 if grouped else MODELLED
    if levels < LOSSLESS_LEVELS:
        return bytes([kind + FORM_LEVELS, levels - 1]) + coded
    others = cells > valid
    if frame.keep is not None or not np.multiply(image, others).any():
        return bytes([kind + FORM_RETURNS]) + coded
    size = len(coded).to_bytes(4, "little")
    return bytes([kind + FORM_ALL_FIRED]) + size + coded + compress(image[others].tobytes(), _LEVEL)


def decode_intensity(data: bytes | None, valid: Mask, cells: Mask, fired: Mask, sensor: SensorModel) -> Bytes:
    """(64, W) uint8; zeros where nothing was sent.

    valid: (64, W), the returns; cells: (64, W), those that fired; fired: (2, W). Raises SectionError.
    """
    if data is None:
        return np.zeros(valid.shape, np.uint8)
    kind, form = divmod(data[0], MODELLED) if data else (-1, -1)
    if kind not in (0, 1) or (form == FORM_LEVELS and len(data) < 2):
        raise SectionError(f"an intensity section of {len(data)} bytes that begins with {data[:1].hex() or 'nothing'}")

    def returns(coded: bytes) -> Bytes:
        if kind:
            return entropy.decode_intensity(coded, valid, fired, sensor)
        image = np.zeros(valid.shape, np.uint8)
        image[valid] = decode_bytes(coded, int(np.count_nonzero(valid)))
        return image

    if form == FORM_RETURNS:
        return returns(data[1:])
    if form == FORM_LEVELS:
        return np.where(valid, intensity_of(returns(data[2:]), data[1] + 1), np.uint8(0))
    split = 5 + int.from_bytes(data[1:5], "little")
    image, others = returns(data[5:split]), cells > valid
    image[others] = np.frombuffer(decompress(data[split:], int(np.count_nonzero(others))), np.uint8)
    return image
