"""What numbers of intensity values cost and show, at each step of the lattice: a part of `benchmarks.working_points`.

Bits of intensities depend on the columns that are sent and on nothing else of a codec, so they are measured once for
all codecs: by the INTENSITY section itself, of frames thinned as the pipeline thins them. What is seen is the RMSE at
the receiver, with gaps filled in, of ranges as they were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.lattice import Lattice, expanded, on_lattice, thinned
from lidarcodec.planes.intensity import Quality, encode_intensity, reduced
from lidarcodec.planes.sections import fired_cells

Floats = npt.NDArray[np.float64]


@dataclass
class Intensities:
    """bits: (steps, levels) per return of the original frame;  rmse: (steps, levels) of 255, at the receiver"""

    bits: Floats
    rmse: Floats


def intensities(
    frames: Sequence[Frame], steps: Sequence[int], levels: Sequence[int], *, grouped: bool = False
) -> Intensities:
    """Both of all frames together. levels: 256 lossless, 0 off;  grouped: as `zstd` writes them."""
    bits, squares = np.zeros((len(steps), len(levels))), np.zeros((len(steps), len(levels)))
    counts = np.zeros((len(steps), len(levels)))
    for frame in frames:
        for at, step in enumerate(steps):
            wide = on_lattice(frame, step)
            narrow = thinned(wide)
            cells = fired_cells(narrow.fired, narrow.sensor)
            for place, number in enumerate(levels):
                quality = Quality(number)
                bits[at, place] += 8 * len(encode_intensity(narrow, cells, quality, grouped=grouped) or b"")
                back = _received(wide, narrow, quality)
                both = (frame.range > 0) & (back.range > 0)
                off = frame.intensity[both].astype(np.int64) - back.intensity[both]
                squares[at, place] += float(np.dot(off, off))
                counts[at, place] += len(off)
    points = sum(frame.points for frame in frames)
    return Intensities(bits / points, np.sqrt(squares / np.maximum(counts, 1)))


def _received(wide: Frame, narrow: Frame, quality: Quality) -> Frame:
    """What a receiver shows of a frame with such intensities."""
    if not quality.levels:
        narrow = narrow.with_(intensity=np.zeros_like(narrow.intensity))
    elif not quality.lossless:
        narrow = narrow.with_(intensity=reduced(narrow, quality))
    if wide.lattice is None:
        return narrow
    return filled(expanded(narrow, Lattice(wide.width, wide.lattice)))
