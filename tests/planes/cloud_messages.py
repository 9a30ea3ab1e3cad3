"""Messages of point clouds of all kinds, by name."""

from __future__ import annotations

import numpy as np

from tests.point_clouds import message, nebula, ouster, plain, ros1, velodyne

VELODYNE = message(velodyne())
OUSTER = message(ouster(), 16)


def shuffled() -> bytes:
    return message(np.random.default_rng(4).permutation(velodyne()))


def other_order() -> bytes:
    """The same fields in another order, with bytes between them, big endian."""
    points = velodyne(100)
    dtype = np.dtype(
        {
            "names": ["time", "ring", "z", "intensity", "y", "x"],
            "formats": [">f4", ">u2", ">f4", ">f4", ">f4", ">f4"],
            "offsets": [1, 5, 9, 13, 20, 24],
            "itemsize": 31,
        }
    )
    found = np.frombuffer(np.random.default_rng(9).bytes(31 * len(points)), dtype).copy()
    for name in dtype.names or ():
        found[name] = points[name]
    return message(found, big_endian=True)


def with_nan() -> bytes:
    """NaN, infinite, zero and huge points among others, NaN of odd bits and negative zeros too."""
    points = velodyne()
    points["x"][5:9] = np.nan
    points["y"][20] = np.inf
    points[["x", "y", "z"]][30] = (0.0, -0.0, 0.0)
    points["x"][40:44] = 3e38
    points["z"].view(np.uint32)[50] = 0x7FC12345
    return message(points, dense=0)


def several() -> bytes:
    """A field of several values, and fields that lie over each other."""
    dtype = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("normal", "<f4", 3), ("bits", "<f8")])
    points = np.zeros(500, dtype)
    for name in "xyz":
        points[name] = velodyne()[name][:500]
    points["normal"] = np.random.default_rng(1).normal(0, 1, (500, 3))
    points["bits"] = -np.arange(500.0)
    return message(points, counts={"normal": 3})


def absolute_times(begin_s: float = 1_700_000_000.0, unit: float = 1.0, *, gaps: bool = False) -> bytes:
    """Float64 coordinates, and times since the epoch, as of some drivers: in seconds, or `unit` to the second.

    gaps: some points have no time, and one has nonsense
    """
    points = velodyne(100)
    dtype = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("ring", "<u2"), ("timestamp", "<f8")]
    found = np.zeros(len(points), dtype)
    for name in ("x", "y", "z", "ring"):
        found[name] = points[name]
    found["timestamp"] = (begin_s + points["time"].astype(np.float64)) * unit
    if gaps:
        found["timestamp"][3:6] = 0.0, np.nan, 1e300
    return message(found)


CLOUDS = {
    "velodyne": VELODYNE,
    "ouster": OUSTER,
    "nebula": message(nebula()),
    "ouster with nan": message(ouster(nan=True), 16),
    "ouster without ring order": message(ouster().reshape(16, -1)[::-1].ravel(), 16),
    "ros1": ros1(VELODYNE),
    "in no order": message(plain(3000, [("rgb", "<f4"), ("label", "<i2"), ("d", "<f8")])),
    "shuffled": shuffled(),
    "without rings": message(velodyne()[["x", "y", "z"]].astype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])),
    "ring by ring": message(velodyne()[np.argsort(velodyne()["ring"], kind="stable")]),
    "other order": other_order(),
    "nan": with_nan(),
    "all nan": message(np.full(64, np.nan, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])),
    "several": several(),
    "float64": absolute_times(),
    "times in ns": absolute_times(unit=1e9),
    "times of another clock": absolute_times(1234.5),
    "times in ns of another clock": absolute_times(1234.5, 1e9),
    "times with gaps": absolute_times(gaps=True),
    "empty": message(velodyne()[:0]),
    "one point": message(velodyne()[:1]),
    "two points": message(velodyne()[:2]),
    "padded rows": message(ouster(), 16, padding=b"\1\2\3"),
    "no coordinates": message(velodyne()[["ring", "time"]].astype([("ring", "<u2"), ("time", "<f4")])),
    "no fields": message(np.zeros(10, [("x", "<f4")]))[:-60],
    "one column": message(ouster(1, 64), 64),
    "tall": message(plain(300), 300),
    "bytes behind": message(velodyne(50), tail=b"more"),
}
