"""Scores of each return from the bundled networks, in one thread: 12 ms, and 6 ms for the image.

`poconet.onnx` and `poconet_others.onnx` are ScoreNet (lidarcodec/training/nets) with 0.1 M weights, trained only on
simulated drives: of an HDL-64E, and of sensors with 16 to 128 rows. `about` lists them. The keep mask is sent, so a
decoder needs neither the networks nor onnxruntime.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.frame import Frame
from lidarcodec.planes.beam_directions import BeamBook
from lidarcodec.reduction.score_image import score_image, unpatched
from lidarcodec.reduction.spread import Returns

OF_HDL64E: Final = "poconet.onnx"
OF_OTHERS: Final = "poconet_others.onnx"
"""Files of weights: for an HDL-64E, and for other sensors."""
Floats = npt.NDArray[np.float32]


class Scores(NamedTuple):
    """(N,) float32 each: logits of the classes, of the rank of the count (higher: seen more often), and of being rarely
    seen, like moving objects."""

    low: Floats
    high: Floats
    ground: Floats
    rank: Floats
    seldom: Floats

    @property
    def is_ground(self) -> npt.NDArray[np.bool_]:
        """(N,) bool, whether ground is the most probable class."""
        return (self.ground > self.low) & (self.ground > self.high)

    @property
    def high_odds(self) -> Floats:
        """(N,) float32, logit of the class high; it increases with the probability."""
        odds: Floats = self.high - np.logaddexp(self.low, self.ground)
        return odds


@cache
def _session(weights: str) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    data = files("lidarcodec.reduction").joinpath(weights).read_bytes()
    return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])


def scores_of(frame: Frame, returns: Returns, book: BeamBook | None = None) -> Scores:
    """Scores of a frame's returns. book: of the stream"""
    image = score_image(frame, returns, book)
    weights = OF_HDL64E if frame.sensor.is_hdl64e else OF_OTHERS
    (patches,) = _session(weights).run(None, {"features": image.features[None]})
    values = unpatched(patches[0]).reshape(len(Scores._fields), -1)
    return Scores(*(value[image.pixel] for value in values))


def about(weights: str) -> dict[str, str]:
    """The metadata of a file of weights, such as `trained_on`, `licence` and `steps`."""
    return dict(_session(weights).get_modelmeta().custom_metadata_map)
