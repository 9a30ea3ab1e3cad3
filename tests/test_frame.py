"""A frame is a value: what a caller does later with what it was made of must not change it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lidarcodec import Frame
from lidarcodec.errors import LidarCodecError
from tests.packets import sensor

WIDTH = 12


def made(**changes: Any) -> Frame:
    fields: dict[str, Any] = {
        "range": np.full((64, WIDTH), 500, np.uint16),
        "intensity": np.zeros((64, WIDTH), np.uint8),
        "azimuth": np.zeros((2, WIDTH), np.uint16),
        "fired": np.ones((2, WIDTH), np.bool_),
    }
    return Frame(index=0, stamp_ns=0, sensor=sensor(), **(fields | changes))


def test_a_read_only_view_of_a_buffer_that_is_reused_is_copied() -> None:
    buffer = np.full((64, WIDTH), 500, np.uint16)
    view = buffer[:]
    view.flags.writeable = False
    frame = made(range=view)
    buffer[0, 0] = 9
    assert frame.range[0, 0] == 500


def test_a_writable_view_is_copied_and_stays_writable() -> None:
    buffer = np.full((64, 2 * WIDTH), 500, np.uint16)
    frame = made(range=buffer[:, :WIDTH])
    buffer[:] = 9
    assert (frame.range == 500).all()


def test_an_array_that_owns_its_data_is_taken_over_and_becomes_read_only() -> None:
    own = np.full((64, WIDTH), 500, np.uint16)
    assert np.shares_memory(made(range=own).range_u16, own)
    with pytest.raises(ValueError, match="read-only"):
        own[0, 0] = 9


def test_ranges_are_wide_for_every_sensor_and_those_of_an_hdl64e_have_16_bits() -> None:
    for dtype in (np.uint16, np.uint32):
        frame = made(range=np.full((64, WIDTH), 65535, dtype))
        assert (frame.range.dtype, frame.range_u16.dtype) == (np.uint32, np.uint16)
        assert (frame.range == 65535).all()
        assert (frame.range_u16 == 65535).all()
        assert not frame.range.flags.writeable
        assert not frame.range_u16.flags.writeable
    with pytest.raises(LidarCodecError, match="16 bits, and this is 65536"):
        made(range=np.full((64, WIDTH), 65536, np.uint32))


@pytest.mark.parametrize(
    "changes",
    [
        {"range": None},
        {"range": [[1]]},
        {"range": np.zeros((64, WIDTH), ">u2")},
        {"intensity": None},
        {"azimuth": [0] * WIDTH},
        {"fired": np.ones((2, WIDTH + 1), np.bool_)},
        {"keep": "all"},
    ],
)
def test_anything_but_the_arrays_of_the_contract_is_refused_by_name(changes: dict[str, Any]) -> None:
    with pytest.raises(LidarCodecError, match=f"{next(iter(changes))}|range image"):
        made(**changes)
