"""Groups of ranges in pco: each in one page, whatever its size."""

from __future__ import annotations

import numpy as np
import pytest

from lidarcodec._native import decode_pco_groups
from lidarcodec.codecs.pcodec import compress_groups
from lidarcodec.errors import DecodeError

PAGE = 262_144
"""Numbers after which pco begins another page, unless it is told not to."""


@pytest.mark.parametrize("size", [1, PAGE - 1, PAGE, PAGE + 1, 3 * PAGE + 5])
@pytest.mark.parametrize("spread", [0, 1, 200])
def test_a_group_is_whole(size: int, spread: int) -> None:
    values = np.random.default_rng(size).integers(5000, 5001 + spread, size).astype(np.uint16)
    np.testing.assert_array_equal(decode_pco_groups(compress_groups(values, 8), size), values)


def test_a_group_that_is_cut_is_refused() -> None:
    values = np.random.default_rng(1).integers(5000, 5200, 2 * PAGE).astype(np.uint16)
    data = compress_groups(values, 8)
    for cut in (data[:-1], data[: len(data) // 2], data + b"\0"):
        with pytest.raises(DecodeError):
            decode_pco_groups(cut, len(values))
