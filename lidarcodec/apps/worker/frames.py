"""Frames between two processes on this machine: a fixed head, then each array in its memory layout.

head   index, stamp, columns, flags, packets, layouts, irregular blocks, second returns, bytes of positions
sensor only if it differs from the previous frame's: name, convention, range step, origin, calibration
    arrays range intensity azimuth fired [keep] [pose] [side: packet_ns gps_us status layouts layout irregular second
           positions, as a POSITION section]

Of another sensor than the HDL-64E a message of codec `raw` follows the head, in as many bytes as the head has packets.

The reader checks everything, because an attacker may control the codec process. It checks counts before it allocates
memory, and refuses invalid values (an azimuth of 36000, a bool that is neither 0 nor 1).
"""

from __future__ import annotations

import math
import struct
from typing import Any, Final, get_args

import numpy as np
import numpy.typing as npt

from lidarcodec.apps.worker.wire import Buffer, Channel, GarbledError
from lidarcodec.codecs.other_sensors import other_decoder, other_encoder
from lidarcodec.entropy import decode_positions, encode_positions
from lidarcodec.errors import LidarCodecError, SectionError
from lidarcodec.frame import Frame, Part
from lidarcodec.sensor_model import CALIBRATION_FIELDS, Calibration, Convention, Origin, SensorModel
from lidarcodec.settings import StreamSettings
from lidarcodec.side import Role, SideInfo
from lidarcodec.units import (
    AZIMUTH_TURN,
    BLOCK_BYTES,
    BLOCKS_PER_PACKET,
    LASERS,
    LASERS_PER_BLOCK,
    MAX_COLUMNS,
    MAX_PACKETS,
    MAX_POSITIONS_BYTES,
)
from lidarcodec.wire import pack, unpack

_HEAD: Final = struct.Struct("<qqIIIIIII")
_SENSOR: Final = struct.Struct("<BBBd")
_HAS_SENSOR, _HAS_SIDE, _HAS_KEEP, _HAS_POSE, _IS_OTHER = 1, 2, 4, 8, 16
_GOES_ON, _MORE = 32, 64
_LIMITS: Final = {
    "columns": MAX_COLUMNS,
    "packets": MAX_PACKETS,
    "layouts": 1 << 16,
    "irregular blocks": MAX_PACKETS * BLOCKS_PER_PACKET,
    "second returns": MAX_PACKETS * BLOCKS_PER_PACKET,
    "bytes of positions": 2 * MAX_POSITIONS_BYTES,
}
_MOST_BYTES: Final = 1 << 26
"""Of a message: the largest frame has 5 Mi numbers of up to 4 bytes, and 32 MiB of odd packets."""
_PLAIN: Final = StreamSettings(codec="raw")
_CONVENTIONS: Final = get_args(Convention)
_ORIGINS: Final = get_args(Origin)
_TABLE: Final = (len(CALIBRATION_FIELDS), LASERS)
_SIDE: Final = ("packet_ns", "gps_us", "status", "layouts", "layout", "irregular", "second")

SensorIdentity = tuple[Any, ...]


def _checked(counts: tuple[int, ...]) -> None:
    for (what, limit), count in zip(_LIMITS.items(), counts, strict=True):
        if count > limit:
            raise SectionError(f"a frame has {count} {what}: at most {limit} are allowed")


def _bytes_of(array: npt.NDArray[Any]) -> Buffer:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data if array.size else b""


def _identity(sensor: SensorModel) -> SensorIdentity:
    return sensor.hash, sensor.name, sensor.convention, sensor.range_step_m, sensor.origin


class FrameWriter:
    """Writes frames as buffers, in order. It remembers the sensor that it wrote last."""

    def __init__(self) -> None:
        self._last_sensor: SensorIdentity | None = None

    def parts(self, frame: Frame) -> list[Buffer]:
        """Buffers of a frame, without copying its images.

        Raises SectionError for a frame that is too large.
        """
        if not frame.sensor.is_hdl64e:
            return _as_message(frame)
        side, sensor = frame.blocks, frame.sensor
        told = _identity(sensor)
        counts, positions = (0, 0, 0, 0, 0), b""
        if side is not None:
            positions = encode_positions(side.positions, host_step_ns=1) if side.positions else b""
            counts = (side.packets, len(side.layouts), len(side.irregular), len(side.second), len(positions))
        _checked((frame.width, *counts))
        flags = (_HAS_SENSOR if told != self._last_sensor else 0) | (_HAS_SIDE if side is not None else 0)
        flags |= (_HAS_KEEP if frame.keep is not None else 0) | (_HAS_POSE if frame.pose is not None else 0)
        flags |= (_GOES_ON if frame.part.goes_on else 0) | (_MORE if frame.part.more else 0)
        parts: list[Buffer] = [_HEAD.pack(frame.index, frame.stamp_ns, frame.width, flags, *counts)]
        if told != self._last_sensor:
            name = sensor.name.encode()
            if len(name) > 0xFF:
                raise SectionError(f"the sensor's name has {len(name)} bytes: at most 255 are allowed")
            at = _CONVENTIONS.index(sensor.convention), _ORIGINS.index(sensor.origin)
            parts += [_SENSOR.pack(*at, len(name), sensor.range_step_m), name, _bytes_of(sensor.calibration.table)]
        arrays: list[npt.NDArray[Any]] = [frame.range_u16, frame.intensity, frame.azimuth, frame.fired]
        arrays += [array for array in (frame.keep, frame.pose) if array is not None]
        arrays += [] if side is None else [getattr(side, name) for name in _SIDE]
        self._last_sensor = told
        return parts + [_bytes_of(array) for array in arrays] + [positions] * bool(positions)


class FrameReader:
    """Reads frames from a channel, in order. It remembers the sensor.

    Raises GarbledError for an invalid frame, and EOFError and TimeoutError of the channel.
    """

    def __init__(self) -> None:
        self._sensor: SensorModel | None = None

    def take(self, channel: Channel, end: float | None = None) -> Frame:
        """The next frame."""
        try:
            return self._take(channel, end)
        except (LidarCodecError, UnicodeDecodeError) as error:
            raise GarbledError(str(error)) from None

    def _take(self, channel: Channel, end: float | None) -> Frame:
        index, stamp_ns, width, flags, *counts = _HEAD.unpack(channel.take(_HEAD.size, end))
        if flags & _IS_OTHER:
            return _of_message(channel, counts[0], end, reduced=bool(flags & _HAS_KEEP))
        _checked((width, *counts))
        if flags & _HAS_SENSOR:
            self._sensor = self._take_sensor(channel, end)
        if self._sensor is None or index < 0 or flags > 127:
            raise GarbledError(f"frame {index} has no sensor")

        def array(dtype: npt.DTypeLike, *shape: int) -> npt.NDArray[Any]:
            whole = np.empty(shape, dtype)
            if whole.size:
                channel.fill(whole.reshape(-1).view(np.uint8).data, end)
            return whole

        images = {
            "range": array(np.uint16, LASERS, width),
            "intensity": array(np.uint8, LASERS, width),
            "azimuth": array(np.uint16, 2, width),
            "fired": _truths(array(np.bool_, 2, width)),
        }
        if images["azimuth"].max(initial=0) >= AZIMUTH_TURN:
            raise GarbledError("a frame has an azimuth beyond a turn")
        keep = _truths(array(np.bool_, LASERS, width)) if flags & _HAS_KEEP else None
        pose = array(np.float64, 4, 4) if flags & _HAS_POSE else None
        side = None
        if flags & _HAS_SIDE:
            packets, layouts, irregular, second, position_bytes = counts
            side = SideInfo(
                array(np.int64, packets),
                array(np.uint32, packets),
                array(np.uint8, packets, 2),
                array(np.uint8, layouts, BLOCKS_PER_PACKET),
                array(np.uint16, packets),
                array(np.uint8, irregular, BLOCK_BYTES),
                array(np.uint8, second, LASERS_PER_BLOCK * 3),
                decode_positions(channel.take(position_bytes, end), packets) if position_bytes else (),
            )
            if side.layouts.max(initial=0) > max(Role):
                raise GarbledError("side information has an unknown role")
        return Frame(
            index,
            stamp_ns,
            images["range"],
            images["intensity"],
            images["azimuth"],
            images["fired"],
            self._sensor,
            side,
            keep,
            pose,
            part=Part(bool(flags & _GOES_ON), bool(flags & _MORE)),
        )

    @staticmethod
    def _take_sensor(channel: Channel, end: float | None) -> SensorModel:
        convention, origin, name_bytes, step_m = _SENSOR.unpack(channel.take(_SENSOR.size, end))
        if convention >= len(_CONVENTIONS) or origin >= len(_ORIGINS) or not (math.isfinite(step_m) and step_m > 0):
            raise GarbledError("a sensor is invalid")
        name = channel.take(name_bytes, end).decode()
        table = np.frombuffer(channel.take(_TABLE[0] * _TABLE[1] * 4, end), np.int32).reshape(_TABLE).copy()
        return SensorModel(name, Calibration(table), _ORIGINS[origin], _CONVENTIONS[convention], step_m)


def _as_message(frame: Frame) -> list[Buffer]:
    """The head, and a key message of codec `raw`. Returns that are not kept are none in it."""
    (message,) = other_encoder(_PLAIN, 0).encode(frame, key=True)
    data = pack(message)
    if len(data) > _MOST_BYTES:
        raise SectionError(f"a frame has {len(data)} bytes: at most {_MOST_BYTES} are allowed")
    flags = _IS_OTHER | (_HAS_KEEP if frame.keep is not None else 0)
    return [_HEAD.pack(frame.index, frame.stamp_ns, frame.width, flags, len(data), 0, 0, 0, 0), data]


def _of_message(channel: Channel, size: int, end: float | None, *, reduced: bool) -> Frame:
    if size > _MOST_BYTES:
        raise GarbledError(f"a frame of {size} bytes")
    message = unpack(channel.take(size, end))
    if not message.planes:
        raise GarbledError("a message of an HDL-64E, not of another sensor")
    frames = other_decoder(message.codec).decode(message)
    if len(frames) != 1:
        raise GarbledError(f"a message of {len(frames)} frames, not one")
    return frames[0].with_(keep=frames[0].range > 0) if reduced else frames[0]


def _truths(array: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    if array.view(np.uint8).max(initial=0) > 1:
        raise GarbledError("a truth value is neither 0 nor 1")
    return array
