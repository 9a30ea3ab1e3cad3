"""`jpeg`: the range image on its canvas as one JPEG, 12 bits a sample (Tu 2016's "normal JPEG", which had 8).

A RANGE section is empty if there is no return, else: what samples mean (jpeg_samples.py), where cells are
(canvas_head.py), and the JPEG.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs.base import Codec, InForce
from lidarcodec.codecs.frame_decoder import independent_decoder
from lidarcodec.codecs.frame_encoder import independent_encoder
from lidarcodec.codecs.jpeg_samples import JpegSettings, ranges_of, split_samples, with_samples
from lidarcodec.codecs.pictures import picture_others
from lidarcodec.codecs.rate_knob import quality_knob
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.ranges.image.aligned_rows import AlignedRows
from lidarcodec.ranges.image.canvas import level_offsets
from lidarcodec.ranges.image.canvas_head import canvas_of_frame, split_canvas
from lidarcodec.ranges.image.jpeg_file import BLOCK, read_jpeg
from lidarcodec.ranges.image.range_cells import Numbers, RangeCells
from lidarcodec.ranges.mapping import Scale
from lidarcodec.sensor_model import SensorModel
from lidarcodec.units import LASERS

Ranges = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


def code_ranges(frame: Frame, settings: InForce[JpegSettings]) -> bytes:
    """The RANGE section of a frame."""
    valid = frame.valid
    if not valid.any():
        return b""
    head, canvas = canvas_of_frame(frame, valid, BLOCK)
    values = np.where(valid, frame.range_u16 + level_offsets(frame.sensor)[:, None], np.int32(0)).astype(np.int32)
    samples, jpeg = with_samples(settings.own, canvas.spread(values), canvas.spread(valid))
    return samples + head + jpeg


def decode_ranges(data: bytes, valid: Mask, sensor: SensorModel) -> Ranges:
    """(N,) uint16, the ranges of a RANGE section. Raises SectionError."""
    if not valid.any():
        if data:
            raise SectionError(f"{len(data)} bytes of ranges for no return")
        return np.zeros(0, np.uint16)
    bits, value_of, rest = split_samples(data)
    canvas, jpeg = split_canvas(rest, valid, sensor, BLOCK)
    values = canvas.gather(value_of[read_jpeg(jpeg, LASERS, canvas.width, bits)])
    return ranges_of(values, level_offsets(sensor), valid)


def write_numbers(numbers: Numbers, cells: RangeCells, own: JpegSettings) -> bytes:
    """What samples mean, and the JPEG of ranges of any sensor, rows aligned."""
    rows = AlignedRows.of(cells.shift, numbers.shape[1], BLOCK)
    values, known = rows.spread(numbers.astype(np.int32)), rows.spread(cells.known)
    return b"".join(with_samples(own, values, known, Scale.of(cells.most, cells.step_m)))


def read_numbers(data: bytes, cells: RangeCells) -> npt.NDArray[np.int32]:
    """(H, W) int32, ranges. Raises SectionError."""
    rows = AlignedRows.of(cells.shift, cells.known.shape[1], BLOCK)
    bits, value_of, jpeg = split_samples(data, Scale.of(cells.most, cells.step_m))
    return rows.gather(value_of[read_jpeg(jpeg, *rows.shape, bits)])


CODEC = Codec(
    JpegSettings,
    independent_encoder(JpegSettings, code_ranges),
    independent_decoder(decode_ranges),
    bounded=False,
    # Chamfer distances are shorter with logarithms, root mean square errors are smaller without.
    knob=quality_knob(mapping="log"),
    others=picture_others(JpegSettings, write_numbers, read_numbers, exact=False),
)
