"""Writes ScoreNet as an ONNX file with its training data in the metadata, for `lidarcodec.reduction.score_network`."""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from lidarcodec.errors import MissingExtraError
from lidarcodec.files.whole import whole
from lidarcodec.reduction.score_image import CHANNELS, MULTIPLE
from lidarcodec.training.nets.score_net import ScoreNet
from lidarcodec.units import LASERS

OPSET = 17


def export_scores(net: ScoreNet, path: Path, about: Mapping[str, str], *, force: bool = True) -> None:
    """Write the network, for images of any height that is a multiple of 8 and width that is a multiple of 16.

    about: its metadata;  force: whether to replace a file of that name

    Raises MissingExtraError without the package onnx; SourceError if the file cannot be written.
    """
    try:
        import onnx
    except ImportError:
        raise MissingExtraError("writing ONNX files", "learned") from None
    example = torch.from_numpy(np.zeros((1, CHANNELS, LASERS, 4 * MULTIPLE), np.float32))
    buffer = io.BytesIO()
    axes = {"features": {2: "rows", 3: "columns"}, "values": {2: "halves", 3: "patches"}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the newer exporter needs further packages
        torch.onnx.export(
            net.cpu().eval(), (example,), buffer, input_names=["features"], output_names=["values"],
            dynamic_axes=axes, opset_version=OPSET, dynamo=False,
        )  # fmt: skip
    model = onnx.load_from_string(buffer.getvalue())
    onnx.helper.set_model_props(model, dict(about))
    with whole(path, force=force) as output:
        output.beside.write_bytes(model.SerializeToString())
