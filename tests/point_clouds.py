"""PointCloud2 messages as drivers lay them out, of a made scene: what they compute in float32, they compute here so."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarcodec.interop.cdr import CdrWriter
from lidarcodec.sensors.clouds.message import TYPE_NUMBERS

STAMP_NS = 1_700_000_000_123_456_789
SINGLE = np.float32
XYZIRT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])
"""velodyne_pointcloud."""
OUSTER = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "t", "reflectivity", "ring", "ambient", "range"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u4", "<u2", "<u2", "<u2", "<u4"],
        "offsets": [0, 4, 8, 16, 20, 24, 26, 28, 32],
        "itemsize": 48,
    }
)
"""ouster-ros, with its padding."""
NEBULA = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "intensity", "distance", "azimuth", "elevation")),
        ("ring", "<u2"),
        *((name, "<f8") for name in ("level", "stamp", "count")),
    ]
)
"""Much as nebula, with numbers in float64."""


def message(
    points: npt.NDArray[np.void],
    height: int = 1,
    *,
    big_endian: bool = False,
    padding: bytes = b"",
    stamp_ns: int = STAMP_NS,
    counts: dict[str, int] | None = None,
    dense: int = 1,
    tail: bytes = b"",
) -> bytes:
    """A structured array, (N,), as message. padding: behind each row; counts: of fields with several values."""
    width = len(points) // height
    writer = CdrWriter().header(stamp_ns, "lidar").u32(height).u32(width).u32(len(points.dtype.names or ()))
    for name in points.dtype.names or ():
        dtype, offset = (points.dtype.fields or {})[name][:2]
        count = (counts or {}).get(name, 1)
        writer.text(name).u32(offset).u8(TYPE_NUMBERS[dtype.base.str[1:]]).u32(count)
    size = points.dtype.itemsize
    writer.u8(int(big_endian)).u32(size).u32(size * width + len(padding))
    raw = points.tobytes()
    rows = [raw[at : at + size * width] + padding for at in range(0, len(raw), size * width)] if raw else []
    return writer.u32(sum(map(len, rows))).raw(b"".join(rows)).u8(dense).raw(tail).done()


def scene(rows: int, columns: int, seed: int = 1) -> npt.NDArray[np.int64]:
    """(H, W) ranges in steps of 2 mm: walls, with some returns missing."""
    rng = np.random.default_rng(seed)
    angle = np.arange(columns) * (2 * np.pi / columns)
    walls = 5000 + 2500 * np.cos(3 * angle)[None] + 100 * np.arange(rows)[:, None]
    ranges = np.rint(walls + rng.normal(0, 4, (rows, columns))).astype(np.int64)
    ranges[rng.random((rows, columns)) < 0.1] = 0
    return ranges


def velodyne(columns: int = 300, rows: int = 16, seed: int = 1) -> npt.NDArray[np.void]:
    """Points of a turn, column by column in the order in which a VLP-16 fires, in float32 as the driver computes."""
    n = scene(rows, columns, seed)
    rng = np.random.default_rng(seed + 1)
    step = 36000 // columns
    azimuth = (np.arange(columns)[None] * step + np.arange(rows)[:, None]) % 36000
    angle = np.radians(azimuth * 0.01).astype(SINGLE)
    elevation = np.radians(np.linspace(-15, 15, rows)).astype(SINGLE)[:, None]
    distance = n.astype(SINGLE) * SINGLE(0.002)
    flat = distance * np.cos(elevation)
    points = np.zeros(n.shape, XYZIRT)
    points["x"], points["y"] = flat * np.cos(angle), -(flat * np.sin(angle))
    points["z"] = distance * np.sin(elevation)
    points["intensity"] = rng.integers(0, 100, n.shape)
    points["ring"] = np.arange(rows)[:, None]
    points["time"] = (np.arange(columns) * 55_296e-9)[None] + (np.arange(rows) * 2304e-9)[:, None]
    firing = np.concatenate((np.arange(0, rows, 2), np.arange(1, rows, 2)))
    found: npt.NDArray[np.void] = points[firing].T[n[firing].T > 0]
    return found


def nebula(columns: int = 300, rows: int = 16) -> npt.NDArray[np.void]:
    """The same points with what they were computed from, and numbers of each column and row, in float64 too."""
    turn = velodyne(columns, rows)
    n = scene(rows, columns)
    step = 36000 // columns
    firing = np.concatenate((np.arange(0, rows, 2), np.arange(1, rows, 2)))
    there = n[firing].T > 0
    angle = np.radians(((np.arange(columns)[:, None] * step + firing[None]) % 36000) * 0.01).astype(SINGLE)
    found = np.zeros(len(turn), NEBULA)
    for name in ("x", "y", "z", "intensity", "ring"):
        found[name] = turn[name]
    found["distance"] = (n[firing].T.astype(SINGLE) * SINGLE(0.002))[there]
    found["azimuth"] = angle[there]
    found["elevation"] = np.radians(np.linspace(-15, 15, rows)).astype(SINGLE)[turn["ring"]]
    found["level"] = 1e-3 * turn["ring"] + 1.0
    found["stamp"] = 1.7e9 + np.broadcast_to(np.arange(columns)[:, None] * 55_296e-9, there.shape)[there]
    found["count"] = (np.float64(1.0).view(np.int64) + np.arange(len(turn)) * 3).view(np.float64)
    return found


def ouster(columns: int = 512, rows: int = 16, *, nan: bool = False) -> npt.NDArray[np.void]:
    """Points of a turn, row by row; cells without a return are 0 or NaN."""
    n = scene(rows, columns) * 2
    turned = -2 * np.pi * np.arange(columns) / columns
    elevation = np.radians(np.linspace(16, -16, rows))[:, None]
    aside = np.radians(np.where(np.arange(rows) % 2, -1.2, 1.2))[:, None]
    along = n * 0.001 - 0.01585
    points = np.zeros(n.shape, OUSTER)
    x = along * np.cos(elevation) * np.cos(turned + aside) + 0.01585 * np.cos(turned)
    y = along * np.cos(elevation) * np.sin(turned + aside) + 0.01585 * np.sin(turned)
    none = np.nan if nan else 0.0
    for name, values in (("x", x), ("y", y), ("z", along * np.sin(elevation) + 0.03618)):
        points[name] = np.where(n > 0, values, none)
    points["range"], points["ring"] = n, np.arange(rows)[:, None]
    points["t"] = np.arange(columns)[None] * 97_656
    points["intensity"] = points["reflectivity"] = np.random.default_rng(3).integers(0, 200, n.shape)
    points["ambient"] = np.arange(columns)[None] % 50
    return points.ravel()


def plain(count: int, fields: Sequence[tuple[Any, ...]] = (), seed: int = 5) -> npt.NDArray[np.void]:
    """Points in no order, with further fields of random bytes."""
    rng = np.random.default_rng(seed)
    dtype = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), *fields])
    points = np.frombuffer(rng.bytes(count * dtype.itemsize), dtype).copy()
    for name in "xyz":
        points[name] = rng.normal(0, 20, count)
    return points


def ros1(data: bytes) -> bytes:
    """A message of ROS 2 (of the form above) as the payload of one of ROS 1."""
    import struct

    from lidarcodec.sensors.clouds.message import ROS1, read_head

    head = read_head(data)
    text = head.frame_id.encode()
    out = struct.pack("<III", 7, *divmod(head.stamp_ns, 10**9)) + struct.pack("<I", len(text)) + text
    out += struct.pack("<III", head.height, head.width, len(head.fields))
    for one in head.fields:
        name = one.name.encode()
        out += (
            struct.pack("<I", len(name)) + name + struct.pack("<IBI", one.offset, TYPE_NUMBERS[one.kind], one.repeated)
        )
    out += struct.pack("<BIII", head.big_endian, head.point_step, head.row_step, head.data_bytes)
    return ROS1 + out + data[head.size :]
