"""Extracts the networks' inputs for returns of a frame, with the native core."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.entropy import columns_in_turn
from lidarcodec.entropy.mask_coder import row_geometry
from lidarcodec.frame import Frame
from lidarcodec.network.networks import INPUTS_ALONE, INPUTS_EXPECTING
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.units import LASERS

Rows = npt.NDArray[np.int8]

SAID: Final = 7
"""Coded decisions of a return: four for its leaf, and three offset bits."""
LABELS: Final = 4 + 2 * SAID
"""Bytes after the inputs in a row: the leaf; the first three offset bits, -1 for missing ones; and for each decision
the prediction of the context models as int16, 0 without context models."""
_WHOLE_SHARE: Final = 65536


def extracted(
    frame: Frame, step: int, expected: npt.NDArray[np.uint16] | None, rows: int, rng: np.random.Generator
) -> Rows:
    """Rows of about `rows` random returns of a frame.

    step: odd quantiser step; expected: (64, W) uint16 expected ranges, 0 = none; None: a key frame
    Raises SectionError if a frame has returns in blocks that did not fire.
    """
    half, rotation = row_geometry(frame.sensor)
    turn = columns_in_turn(frame.azimuth) if frame.fired.all() else None
    share = min(_WHOLE_SHARE, -(-rows * _WHOLE_SHARE // max(1, int(np.count_nonzero(frame.valid)))))
    inputs, leaves, bits = _native.riddle_samples(
        frame.range_u16,
        np.ascontiguousarray(frame.valid).view(np.uint8),
        step,
        level_offsets(frame.sensor),
        frame.fired.view(np.uint8),
        half,
        rotation,
        turn or 0,
        np.zeros((LASERS, 0), np.uint16) if expected is None else expected,
        share,
        int(rng.integers(1 << 32)),
    )
    return rows_of(inputs, leaves, bits, np.zeros((len(leaves), SAID), np.int16))


def rows_of(
    inputs: npt.NDArray[np.int8],
    leaves: npt.NDArray[np.uint8],
    bits: npt.NDArray[np.uint8],
    said: npt.NDArray[np.int16],
) -> Rows:
    """(n, inputs + 18) int8: inputs, leaf, three offset bits or -1, and 14 bytes of context predictions."""
    labels = np.concatenate([leaves.view(np.int8)[:, None], bits.view(np.int8)], axis=1)  # 255 (no bit) becomes -1
    return np.concatenate([inputs, labels, said.astype("<i2").view(np.int8)], axis=1)


def row_bytes(expects: bool) -> int:
    """Bytes of a row."""
    return (INPUTS_EXPECTING if expects else INPUTS_ALONE) + LABELS


def joined(parts: list[Rows], *, expects: bool) -> Rows:
    """All rows of one kind."""
    return np.concatenate([np.empty((0, row_bytes(expects)), np.int8), *parts])
