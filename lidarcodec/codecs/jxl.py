"""`jxl`: the range image on its canvas as lossless JPEG XL of 16 bits. Lossless or with a bound.

A RANGE section is the step u16 and, if there are returns, the head of the canvas (canvas_head.py) and a bare JPEG XL
codestream. Its samples are indices of quantised ranges on the canvas' scale; with step 1 they wrap at 65536.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic import Field

from lidarcodec.codecs.base import Codec, CodecSettings, InForce
from lidarcodec.codecs.frame_decoder import independent_decoder
from lidarcodec.codecs.frame_encoder import independent_encoder
from lidarcodec.codecs.pictures import picture_others
from lidarcodec.codecs.rate_knob import bound_knob
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.ranges.image.aligned_rows import AlignedRows
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.ranges.image.canvas_head import canvas_of_frame, split_canvas
from lidarcodec.ranges.image.holes import filled_predicted
from lidarcodec.ranges.image.jxl_file import read_jxl, write_jxl
from lidarcodec.ranges.image.range_cells import Numbers, RangeCells
from lidarcodec.ranges.quantise import quantise, reconstruct
from lidarcodec.ranges.steps import split_step, with_step
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import LASERS

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


class JxlSettings(CodecSettings):
    """Settings of `jxl`."""

    effort: int = Field(default=1, ge=1, le=9)
    """Effort of JPEG XL. 2 saves 1 to 6 % and takes ten times as long. More than 2 saves nothing more."""


def _indices_added(sensor: SensorModel, step: int) -> Ranges:
    """(64, 1) uint16, indices to add to each row, so that rows are on one scale to within a step."""
    added = (level_offsets(sensor) + step // 2) // step
    return added.astype(np.uint16)[:, None]


def code_ranges(frame: Frame, settings: InForce[JxlSettings]) -> bytes:
    """The RANGE section of a frame."""
    step = settings.stream.step
    if not frame.valid.any():
        return with_step(step, b"")
    head, canvas = canvas_of_frame(frame, frame.valid)
    levelled = quantise(frame.range_u16, step) + _indices_added(frame.sensor, step)
    filled = filled_predicted(canvas.spread(levelled), canvas.spread(frame.valid))
    return with_step(step, head + write_jxl(filled, settings.own.effort))


def decode_ranges(data: bytes, valid: Mask, sensor: SensorModel) -> Ranges:
    """(N,) uint16, the ranges of a RANGE section. Raises SectionError."""
    step, rest = split_step(data)
    if not valid.any():
        if rest:
            raise SectionError(f"{len(rest)} bytes of ranges for no return")
        return np.zeros(0, np.uint16)
    canvas, codestream = split_canvas(rest, valid, sensor)
    levelled = canvas.gather(read_jxl(codestream, LASERS, canvas.width))
    return reconstruct((levelled - _indices_added(sensor, step))[valid], step)


def write_numbers(numbers: Numbers, cells: RangeCells, own: JxlSettings) -> bytes:
    """The codestream of the lower 16 bits of range numbers of any sensor, rows aligned."""
    rows = AlignedRows.of(cells.shift, numbers.shape[1])
    return write_jxl(filled_predicted(rows.spread(numbers.astype(np.uint16)), rows.spread(cells.known)), own.effort)


def read_numbers(data: bytes, cells: RangeCells) -> Ranges:
    """(H, W) uint16, those bits. Raises SectionError."""
    return AlignedRows.of(cells.shift, cells.known.shape[1]).gather(read_jxl(data, *cells.known.shape))


CODEC = Codec(
    JxlSettings,
    independent_encoder(JxlSettings, code_ranges),
    independent_decoder(decode_ranges),
    knob=bound_knob(),
    others=picture_others(JxlSettings, write_numbers, read_numbers, exact=True),
)
