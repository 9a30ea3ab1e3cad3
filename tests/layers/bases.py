"""Bases of small frames, with their refinements."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.layers import RefinableFrame
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import settings_from
from tests.contracts import frames


class Sent(NamedTuple):
    """A frame, the message of its base, that as decoded, and what codes its refinements."""

    frame: Frame
    message: Message
    base: Frame
    refinable: RefinableFrame


def turn(width: int = 96, index: int = 0) -> Frame:
    """A whole turn of few columns, with intensities in all cells."""
    frame = frames.scene(width // 6, seed=4, index=index)
    azimuth = np.tile((np.arange(width) * 36000 // width).astype(np.uint16), (2, 1))
    bright = np.random.default_rng(index).integers(0, 90, frame.intensity.shape).astype(np.uint8)
    return frame.with_(azimuth=azimuth, intensity=bright)


def sent(frame: Frame | None = None, **settings: Any) -> Sent:
    """A frame as a stream with `base_error_m` sends it; by default a turn, 5 cm, `predictive`."""
    given = turn() if frame is None else frame
    encoder = StreamEncoder(settings_from({"codec": "predictive", "base_error_m": 0.05} | settings), 7)
    (message,) = encoder.encode(given)
    (base,) = StreamDecoder().decode(message)
    assert encoder.refinable is not None
    return Sent(given, message, base, encoder.refinable)
