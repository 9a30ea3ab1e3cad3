"""The INTENSITY section: intensities of the returns, and those of the no-return cells if any is not zero.

Forms (docs/wire-format.md). The codecs write modelled bytes (entropy/intensity_coder.py), `zstd` grouped ones
(neighbour.py), which are a fifth larger and take a third of the time; every decoder reads both.

0 returns, grouped; 1 u32 size of the grouped returns, these, and one zstd frame for the fired cells without a return;
2 returns reduced to few values, grouped as in form 0: tells that the intensities are not those of the sensor;
3, 4 and 5 the same with modelled returns.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec import entropy
from lidarcodec.entropy import IntensityMemory
from lidarcodec.entropy.zstd_frames import compress
from lidarcodec.frame import Frame
from lidarcodec.planes.neighbour import encode_bytes
from lidarcodec.settings import StreamSettings

FORM_RETURNS: Final = 0
FORM_ALL_FIRED: Final = 1
FORM_FEW: Final = 2
MODELLED: Final = 3
"""Added to the number of a form if its returns are modelled."""
LOSSLESS_LEVELS: Final = 256
_LEVEL: Final = 3

Bytes = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


class Quality(NamedTuple):
    """Accuracy of decoded intensities.

    levels: most different values in a frame, 256 = lossless, 0 = off; error: if not 0, the largest error, used instead
    """

    levels: int
    error: int = 0

    @classmethod
    def of(cls, settings: StreamSettings) -> Quality:
        """The quality in the settings."""
        return cls(settings.intensity_levels, settings.intensity_error)

    @property
    def lossless(self) -> bool:
        """Whether every fired cell keeps its intensity."""
        return self.levels == LOSSLESS_LEVELS and not self.error


def reduced(frame: Frame, quality: Quality) -> Bytes:
    """(64, W) uint8, the intensities of the frame's returns reduced to few values; zeros elsewhere.

    quality: neither off nor lossless
    """
    valid = frame.valid
    if not quality.error:
        return entropy.choose_levels(frame.intensity, valid, frame.fired, frame.sensor, quality.levels)
    table = values_within(np.bincount(frame.intensity[valid], minlength=256), quality.error)
    return np.where(valid, table[frame.intensity], np.uint8(0))


def values_within(counts: npt.NDArray[np.intp], error: int) -> Bytes:
    """(256,) uint8, for each intensity a value at most `error` away; as few different values as possible.

    A value is near the mean of the intensities that it replaces. counts: (256,), how often each intensity occurs
    """
    table = np.arange(256, dtype=np.uint8)
    used = np.flatnonzero(counts)
    while used.size:
        group = used[used <= used[0] + 2 * error]
        mean = np.rint(np.average(group, weights=counts[group]))
        table[group] = np.clip(mean, group[-1] - error, group[0] + error)
        used = used[group.size :]
    return table


def encode_intensity(
    frame: Frame,
    cells: Mask,
    quality: Quality,
    *,
    turn: int | None = None,
    grouped: bool = False,
    memory: IntensityMemory | None = None,
) -> bytes | None:
    """Bytes of the section, or None when intensity is off; 4 ms for 120,000 returns, 1.5 ms if grouped.

    A choice among few values takes 4 ms more. cells: (64, W), those that fired; turn: columns in a full turn, as for
    the mask; grouped: take forms 0 to 2; memory: what lossless intensities go on from, changed. Few values begin
    anew in each message. Of a reduced frame intensities without a return are not sent.
    """
    if not quality.levels:
        return None
    valid, image = frame.valid, frame.intensity
    if not quality.lossless:
        image = reduced(frame, quality)
    coded = (
        encode_bytes(image[valid])
        if grouped
        else entropy.encode_intensity(
            image,
            valid,
            frame.fired,
            frame.sensor,
            turn=turn,
            memory=memory if quality.lossless else None,
            azimuth=frame.azimuth,
        )
    )
    kind = 0 if grouped else MODELLED
    if not quality.lossless:
        return bytes([kind + FORM_FEW]) + coded
    others = cells > valid
    if frame.keep is not None or not np.multiply(image, others).any():
        return bytes([kind + FORM_RETURNS]) + coded
    size = len(coded).to_bytes(4, "little")
    return bytes([kind + FORM_ALL_FIRED]) + size + coded + compress(image[others].tobytes(), _LEVEL)
