"""One section of a message, read by the decoder of a stream as a part of a whole message."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lidarcodec.codecs import table
from lidarcodec.codecs.zstd import folded_differences
from lidarcodec.entropy import encode_azimuth, encode_mask
from lidarcodec.entropy.zstd_frames import compress
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.planes.calibrations import encode_calibration
from lidarcodec.ranges.steps import with_step
from lidarcodec.sensor_model import SensorModel
from tests.contracts import frames


def empty(kind: SectionType, data: bytes, *, index: int = 7) -> Message:
    """A key message of codec `raw` without columns, and with this section."""
    sections = {
        SectionType.CALIBRATION: encode_calibration(frames.SENSOR, key=True, plain=True),
        SectionType.RANGE: b"",
        SectionType.AZIMUTH: b"",
        kind: data,
    }
    parts = tuple(Section(int(each), held) for each, held in sections.items())
    return Message(table.codec_id("raw"), 1, index, 0, key=True, width=0, packets=0, sections=parts)


def read_intensity(
    data: bytes, valid: npt.NDArray[np.bool_], fired: npt.NDArray[np.bool_], sensor: SensorModel
) -> npt.NDArray[np.uint8]:
    """(64, W) uint8, what an INTENSITY section holds. valid: (64, W), the returns; fired: (2, W)."""
    ones = compress(folded_differences(np.ones(int(np.count_nonzero(valid)), np.uint16)), 3)
    sections = {
        SectionType.CALIBRATION: encode_calibration(sensor, key=True, plain=True),
        SectionType.AZIMUTH: encode_azimuth(np.zeros(fired.shape, np.uint16), fired),
        SectionType.MASK: encode_mask(valid, fired, sensor),
        SectionType.RANGE: with_step(1, ones),
        SectionType.INTENSITY: data,
    }
    parts = tuple(Section(int(each), held) for each, held in sections.items())
    width = fired.shape[1]
    message = Message(table.codec_id("zstd"), 1, 7, 0, key=True, width=width, packets=0, sections=parts)
    (frame,) = _decoded(message)
    return frame.intensity


def _decoded(message: Message) -> list[Frame]:
    return table.make_decoder(message.codec).decode(message)
