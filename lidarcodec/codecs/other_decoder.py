"""Decoder of frames of other sensors than the HDL-64E, on the native core's decoder of a stream (native/src/session).

The session reads all of a frame of images. Of a point cloud it reads the sensor, and the CLOUD section is read here. Of
a model that the package has and the core does not have yet, layout and directions are those of the package.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from lidarcodec import _native
from lidarcodec.codecs.frame_decoder import check_codec
from lidarcodec.entropy import decode_positions
from lidarcodec.entropy.rest_coder import rest_of
from lidarcodec.entropy.zstd_frames import decompress
from lidarcodec.frame import Frame
from lidarcodec.image_frame import cloud_frame, frame_of_planes, image_frame
from lidarcodec.message import Message, SectionType
from lidarcodec.network.shelf import shipped_file
from lidarcodec.planes.clouds.section import decode_cloud
from lidarcodec.planes.lattice_section import inflated
from lidarcodec.planes.other_calibrations import described_sensor
from lidarcodec.sensor_model import HDL64E
from lidarcodec.sensors.clouds.grid import grid_of
from lidarcodec.sensors.models.table import is_known


class PlaneDecoder:
    """Decoder of frames of other sensors than the HDL-64E, of a codec that codes all planes alike."""

    def __init__(self, codec_id: int) -> None:
        self.codec_id = codec_id
        self._session: Final = _native.Session(decompress, inflated, shipped_file, False, _is_other)

    def decode(self, message: Message) -> list[Frame]:
        """The message's frame.

        Raises DecodeError; MissingReferenceError when a key message has to come first.
        """
        check_codec(message, self.codec_id)
        described, planes, rest, azimuth, lattice, moved = self._session.decode_images(message)
        try:
            sensor = described_sensor(*described)
            found = rest_of(rest)
            if message.has(SectionType.POSITION):
                coded = message.section(SectionType.POSITION)
                found = found.with_positions(decode_positions(coded, message.packets))
            pose = None if moved is None else np.vstack([moved, [0.0, 0.0, 0.0, 1.0]])
            index, stamp_ns = message.frame_index, message.stamp_ns
            if sensor.is_cloud:
                cloud = decode_cloud(message.section(SectionType.CLOUD))
                find = grid_of if cloud.grid is None else lambda _: cloud.grid
                frame = cloud_frame(index, stamp_ns, cloud.payload, sensor, found.positions, find)
            elif _native.knows_model(sensor.model):
                frame = frame_of_planes(index, stamp_ns, dict(planes), azimuth, found, sensor)
            else:
                frame = image_frame(index, stamp_ns, dict(planes), found, sensor)
        except BaseException:
            self._session.cut()
            raise
        return [frame.with_(pose=pose, lattice=lattice)]

    def flush(self) -> list[Frame]:
        """Nothing: no frame is held back."""
        return []


def _is_other(model: str) -> bool:
    """Whether a sensor of this model describes itself. An HDL-64E does not: its frames have sections of their own."""
    return model != HDL64E and is_known(model)
