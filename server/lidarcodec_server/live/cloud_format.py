"""A decoded frame as bytes that a viewer passes to its graphics card. docs/live-sockets.md describes the format.

A header of 96 bytes, or 192 with a pose, then arrays, each padded to 4 bytes. Coordinates are int16 in steps of 4 mm,
which reach 131 m. A frame with a point further away has a larger step, so no point is clipped.
"""

from __future__ import annotations

import struct
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarcodec.cloud import cloud_to_show, xyz_of
from lidarcodec.filling import filled
from lidarcodec.frame import Frame
from lidarcodec.frame_images import layout_of
from lidarcodec.sensor_model import CALIBRATION_FIELDS, SensorModel
from lidarcodec.sources.unit_calibration import note_of
from lidarcodec.units import LASERS, LASERS_PER_BLOCK
from lidarcodec_server.live.cloud_image import FARTHEST_M, cloud_image
from lidarcodec_server.live.options import Encoding
from lidarcodec_server.live.ring_geometry import facts_of_rings, ring_geometry, shown_ranges, shown_step

FORMAT_VERSION: Final = 1
MAGIC: Final = {"points": b"LDCP", "range": b"LDCR"}
HEADER: Final = struct.Struct("<4s2H2Q2q2H3If4f2HI12x")
FLAGS: Final = {"intensity": 1, "ring": 2, "range": 4, "original": 16, "filled": 64}
POSED: Final = 32
"""Flag: the header contains a pose."""
POSE: Final = struct.Struct("<12d")
Ranges = npt.NDArray[np.uint16]
THINNED: Final = 8
"""Flag: points were omitted because of max_points."""
MADE_UP: Final = 128
"""Flag: some returns are interpolated between columns that were sent."""
STEP_M: Final = 0.004
_LARGEST: Final = 32767
_NOT_ANGLES: Final = ("focal_distance_m", "focal_slope", "min_intensity", "max_intensity")


class Facts(NamedTuple):
    """Facts about a frame that are not in it: its stream, the codec's number, the number of frames of the stream
    that were lost, milliseconds from its last packet to its decoding (None: unknown), and the host time of the
    decoding."""

    stream_id: int
    codec: int
    missing: int
    latency_ms: float | None
    decoded_ns: int


def packed(frame: Frame, facts: Facts, encoding: Encoding, original: Ranges | None = None) -> bytes:
    """Bytes of a frame; 2.5 to 4 ms for 120,000 points, 0.1 ms as a range image.

    original: the ranges before coding, for an encoding with `original`; if None, that array is omitted
    """
    if encoding.fill:
        frame = filled(frame)
    if frame.filled is None:
        encoding = _without(encoding, "filled")
    if encoding.form == "range" and frame.sensor.is_cloud:
        return _cloud_image(frame, facts, encoding)
    if encoding.form == "range":
        return _range_image(frame, facts, encoding, original)
    if not frame.sensor.is_hdl64e:
        return _other_points(frame, facts, encoding)
    chosen = np.flatnonzero(frame.valid.T)
    there = len(chosen)
    if encoding.max_points is not None and there > encoding.max_points:
        chosen = chosen[np.arange(encoding.max_points, dtype=np.int64) * there // encoding.max_points]
    axes = [axis.ravel()[chosen] for axis in xyz_of(frame, np.float32)]
    reach_m = max((float(np.abs(axis).max()) for axis in axes), default=0.0) if len(chosen) else 0.0
    step_m = float(np.float32(max(STEP_M, reach_m * 1.0001 / _LARGEST)))
    arrays: list[npt.NDArray[Any]] = [np.rint(axis / np.float32(step_m)).astype("<i2") for axis in axes]
    images: dict[str, npt.NDArray[Any]] = {
        "intensity": frame.intensity,
        "range": frame.range_u16,
        "filled": _made_up(frame),
    }
    for name in encoding.attributes:
        arrays.append((chosen % LASERS).astype(np.uint8) if name == "ring" else images[name].T.ravel()[chosen])
    return _message(frame, facts, encoding, len(chosen), len(chosen) < there, step_m, arrays)


def _other_points(frame: Frame, facts: Facts, encoding: Encoding) -> bytes:
    """Points of a sensor other than an HDL-64E. Ranges are not sent, because they can need more than 16 bits."""
    encoding = _without(encoding, "range")
    cloud = cloud_to_show(frame)
    there = len(cloud)
    made_up = np.zeros(0, np.uint8)
    if "filled" in encoding.attributes:
        made_up = _made_up(frame).T[frame.valid.T][:there]  # of no points, if they cannot be known
    if frame.sensor.is_cloud:
        cloud = cloud[np.sqrt(sum(np.square(cloud[axis], dtype=np.float64) for axis in "xyz")) <= FARTHEST_M]
    if encoding.max_points is not None and len(cloud) > encoding.max_points:
        chosen = np.arange(encoding.max_points, dtype=np.int64) * len(cloud) // encoding.max_points
        cloud, made_up = cloud[chosen], made_up[chosen] if len(made_up) else made_up
    reach_m = max((float(np.abs(cloud[axis]).max()) for axis in "xyz"), default=0.0) if len(cloud) else 0.0
    step_m = float(np.float32(max(STEP_M, reach_m * 1.0001 / _LARGEST)))
    arrays: list[npt.NDArray[Any]] = [np.rint(cloud[axis] / np.float32(step_m)).astype("<i2") for axis in "xyz"]
    more = {"intensity": _bytes_of(cloud["intensity"]), "ring": cloud["ring"], "filled": made_up}
    arrays += [more[name] for name in encoding.attributes]
    measured = there if frame.sensor.is_cloud else None
    return _message(frame, facts, encoding, len(cloud), len(cloud) < there, step_m, arrays, measured)


def _bytes_of(intensity: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """16-bit intensities as 8 bits, clipped to 255."""
    found: npt.NDArray[np.uint8] = np.minimum(intensity, 255).astype(np.uint8)
    return found


def _without(encoding: Encoding, attribute: str) -> Encoding:
    return encoding._replace(attributes=tuple(name for name in encoding.attributes if name != attribute))


def _made_up(frame: Frame) -> npt.NDArray[np.uint8]:
    """(64, W) uint8, 1 for an interpolated return."""
    return np.zeros(frame.range.shape, np.uint8) if frame.filled is None else frame.filled.view(np.uint8)


def _measured(frame: Frame) -> int:
    """Number of returns that were sent."""
    valid = frame.valid if frame.filled is None else frame.valid & ~frame.filled
    return int(np.count_nonzero(valid))


def _range_image(frame: Frame, facts: Facts, encoding: Encoding, original: Ranges | None) -> bytes:
    valid = frame.valid
    returns = int(np.count_nonzero(valid))
    arrays: list[npt.NDArray[Any]] = [shown_ranges(frame), frame.azimuth]
    if "intensity" in encoding.attributes:
        arrays.append(_bytes_of(frame.intensity))
    if "original" in encoding.attributes:
        if original is None or original.shape != frame.range.shape:
            encoding = _without(encoding, "original")
        else:
            arrays.append(original)
    if "filled" in encoding.attributes:
        arrays.append(_made_up(frame))
    step_m = frame.sensor.range_step_m * shown_step(frame)
    return _message(frame, facts, encoding, returns, False, step_m, arrays)


def _cloud_image(frame: Frame, facts: Facts, encoding: Encoding) -> bytes:
    """The range image of a point cloud; it has no original, whose points would lie in other cells."""
    image = cloud_image(frame)
    arrays: list[npt.NDArray[Any]] = [image.ranges, np.stack((image.azimuth, image.azimuth))]
    encoding = encoding._replace(attributes=tuple(one for one in encoding.attributes if one == "intensity"))
    if encoding.attributes:
        arrays.append(image.intensity)
    drawn = image.drawn
    shape, points = image.ranges.shape, image.points
    return _message(frame, facts, encoding, drawn, drawn < points, image.step_m, arrays, points, shape)


def _message(
    frame: Frame,
    facts: Facts,
    encoding: Encoding,
    count: int,
    thinned: bool,
    step_m: float,
    arrays: list[npt.NDArray[Any]],
    measured: int | None = None,
    shape: tuple[int, ...] | None = None,
) -> bytes:
    """measured: number of returns that were sent;  shape: of the images; both if they are not those of the frame"""
    rows, columns = shape or (frame.sensor.rows, frame.width)
    if measured is None:
        measured = _measured(frame)
    pose = b"" if frame.pose is None else POSE.pack(*frame.pose[:3].ravel())
    parts = [b"", pose]
    for array in arrays:
        data = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        parts += [data, b"\0" * (-len(data) % 4)]
    flags = sum(FLAGS[name] for name in encoding.attributes) | (THINNED if thinned else 0)
    flags |= (POSED if pose else 0) | (MADE_UP if frame.filled is not None else 0)
    latency_ms = float("nan") if facts.latency_ms is None else facts.latency_ms
    parts[0] = HEADER.pack(
        MAGIC[encoding.form], FORMAT_VERSION, HEADER.size + len(pose), facts.stream_id, frame.index, frame.stamp_ns,
        facts.decoded_ns, facts.codec, flags, count, measured, min(facts.missing, 2**32 - 1), latency_ms,
        step_m, 0.0, 0.0, 0.0, columns, rows, HEADER.size + sum(map(len, parts)),
    )  # fmt: skip
    return b"".join(parts)


def sensor_key(frame: Frame) -> object:
    """What tells whether `sensor_facts` may differ from those of another frame; a point cloud has its own in each."""
    sensor, found = frame.sensor, layout_of(frame)
    itself = frame if sensor.is_cloud else None
    return sensor.hash, sensor.convention, None if found is None else found[1].name, frame.width > 0, itself


def sensor_facts(sensor: SensorModel, frame: Frame | None = None) -> dict[str, Any]:
    """What a viewer needs to compute points from a range image: for each ring the laser, its block, and its calibration
    in radians and metres (docs/live-sockets.md has the formula).

    frame: a frame of the sensor; needed to fit the geometry of a sensor other than an HDL-64E
    """
    about = {"name": sensor.name, "model": sensor.model, "hash": sensor.hash, "origin": sensor.origin}
    if not sensor.is_hdl64e and frame is not None:
        image = cloud_image(frame) if sensor.is_cloud else None
        geometry = ring_geometry(frame) if image is None else image.geometry
        step_m = sensor.range_step_m * shown_step(frame) if image is None else image.step_m
        rings = facts_of_rings(frame, geometry, step_m)
        return {**about, "convention": "veloview", "note": note_of(sensor), **rings}
    order = sensor.laser_of_ring
    values = {
        name: [round(float(value), 9) for value in sensor.calibration[name][order]]
        for name in CALIBRATION_FIELDS
        if name not in _NOT_ANGLES
    }
    return {
        **about,
        "convention": sensor.convention,
        "range_step_m": sensor.range_step_m,
        "rings": LASERS,
        "laser": [int(laser) for laser in order],
        "block": [int(laser >= LASERS_PER_BLOCK) for laser in order],
        **values,
    }
