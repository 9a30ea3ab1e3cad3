"""The whole way: an image to bytes and back, from nothing but what a decoder has.

A cell needs only cells above and to the left, so rows run one column behind each other and the cells on such a slanted
front are predicted together. Encoder and decoder call the network with the same cells in the same batches: only so do
floats come out the same, and only on one machine with one build of torch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt
import torch

from lidarcodec.errors import UnknownNameError
from research.riddle_paper.context import ContextReader, Contexts, Indices, step_feature
from research.riddle_paper.images import Cells, PaperImage
from research.riddle_paper.moved import MovedPoints
from research.riddle_paper.net import RiddlePaper, predicted
from research.riddle_paper.residuals import (
    Residuals,
    decode_sparse,
    decode_varint,
    encode_sparse,
    encode_varint,
)

Coder = Literal["sparse", "varint"]
CODERS: dict[str, tuple[Callable[[Residuals], bytes], Callable[[bytes, int], Residuals]]] = {
    "sparse": (encode_sparse, decode_sparse),
    "varint": (encode_varint, decode_varint),
}
MOST_CELLS = 1 << 17
"""Largest prediction, in steps."""
_BATCH = 128


class Predictor:
    """A network in use. Predictions are whole steps, as residuals must be."""

    def __init__(self, net: RiddlePaper, device: torch.device) -> None:
        self._net, self._device = net.to(device).eval(), device

    def predict(self, contexts: Contexts, image: PaperImage) -> Cells:
        """(N,) int32, the steps that cells will have; the last valid one where no neighbour is valid.

        A temporal network does without the scan before where contexts have none: as if it held no points.
        """
        contexts = contexts.widened(self._net.shape.neighbours)
        with torch.inference_mode():
            steps = torch.full((len(contexts.valid),), step_feature(image.step), device=self._device)
            features, valid, anchors = (
                torch.from_numpy(part).to(self._device)
                for part in (contexts.features, contexts.valid, contexts.anchors_m)
            )
            logits, residuals = self._net(features, valid, steps)
            ranges = predicted(logits, residuals, anchors).cpu().numpy()
        ranges = np.where(contexts.valid.any(axis=1), ranges, contexts.before_m)
        cells: Cells = np.rint(ranges / np.float32(image.step_m)).clip(0, MOST_CELLS).astype(np.int32)
        return cells

    def predict_all(self, image: PaperImage, earlier: MovedPoints | None = None) -> Cells:
        """(H, W) int32, predictions of all valid cells of an image that is known, 0 elsewhere.

        For measuring: batches are not those of a decoder, so a cell in many thousands may differ from its prediction.
        """
        reader = ContextReader(image, earlier)
        out = np.zeros_like(image.cells)
        rows, columns = np.nonzero(image.valid)
        for at in range(0, len(rows), _BATCH):
            some = rows[at : at + _BATCH], columns[at : at + _BATCH]
            out[some] = self.predict(reader.read(*some), image)
        return out


def encode_image(
    image: PaperImage, predictor: Predictor, earlier: MovedPoints | None = None, coder: Coder = "sparse"
) -> bytes:
    """Bytes of an image's ranges. Raises UnknownNameError for a coder that does not exist."""
    encode, _ = _coder(coder)
    reader = ContextReader(image, earlier, complete=False)
    left = np.zeros_like(image.cells)
    for rows, columns in _fronts(image.valid):
        expected = _expect(reader, predictor, image, rows, columns)
        here = image.valid[rows, columns]
        left[rows[here], columns[here]] = image.cells[rows[here], columns[here]] - expected
        reader.see(rows, columns, image.cells[rows, columns])
    return encode(left[image.valid].astype(np.int64))


def decode_image(
    data: bytes, image: PaperImage, predictor: Predictor, earlier: MovedPoints | None = None, coder: Coder = "sparse"
) -> PaperImage:
    """The image that was encoded.

    image: gives mask, directions and step; its ranges are not looked at
    Raises SectionError, TruncatedError or UnknownNameError.
    """
    _, decode = _coder(coder)
    image = image.with_cells(np.zeros_like(image.cells))
    left = np.zeros(image.cells.shape, np.int64)
    left[image.valid] = decode(data, int(image.valid.sum()))
    reader = ContextReader(image, earlier, complete=False)
    cells = image.cells.copy()
    for rows, columns in _fronts(image.valid):
        expected = _expect(reader, predictor, image, rows, columns)
        here = image.valid[rows, columns]
        cells[rows[here], columns[here]] = expected + left[rows[here], columns[here]]
        reader.see(rows, columns, cells[rows, columns])
    return image.with_cells(cells)


def _expect(reader: ContextReader, predictor: Predictor, image: PaperImage, rows: Indices, columns: Indices) -> Cells:
    """(M,) int32, predictions of the valid cells of a front."""
    reader.arrive(rows, columns)
    here = image.valid[rows, columns]
    if not here.any():
        return np.zeros(0, np.int32)
    return predictor.predict(reader.read(rows[here], columns[here]), image)


def _fronts(valid: npt.NDArray[np.bool_]) -> Iterator[tuple[Indices, Indices]]:
    """Rows and columns of the cells that can be predicted together, front by front."""
    height, width = valid.shape
    if not height:
        return
    for front in range(width + height - 1 if width else 0):
        rows = np.arange(max(0, front - width + 1), min(height, front + 1))
        yield rows, front - rows


def _coder(name: str) -> tuple[Callable[[Residuals], bytes], Callable[[bytes, int], Residuals]]:
    if name not in CODERS:
        raise UnknownNameError("coder of residuals", name, CODERS)
    return CODERS[name]
