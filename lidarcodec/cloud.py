"""Frame -> structured array of points in metres. The only place below the lossy codecs where ranges become floats.

For a laser with elevation v, rotation correction rot, vertical and horizontal offset vo and ho, at azimuth a:

    beta = a - rot;  D = 2 mm * range + dist_correction
    ros:       r = D cos v - vo sin v,  z = D sin v + vo cos v     (the vertical offset is turned by the elevation)
    veloview:  r = D cos v,             z = D sin v + vo           (not turned, as in VeloView and its CSV files)
    x = r cos beta + ho sin beta   (forward)
    y = ho cos beta - r sin beta   (left)

`ros` also applies the two-point distance correction of HDL-64E S3 manual rev. K, appendix F: near targets (calibrated
at 2.4 m across and 1.93 m along) are corrected by dist_correction_x and _y, far ones (25.04 m) by dist_correction. In
between the correction is linear in the coordinate, separately across and along. z takes the correction along, as in the
manual and the ROS driver. Beyond 25.04 m the far correction holds (the manual: "nearer than 25 m only"); the ROS driver
extrapolates there.

Angles are looked up per column and per laser and added by the addition theorem: no trigonometry per point.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from lidarcodec import _native
from lidarcodec.errors import CalibrationError, SectionError, UnknownNameError
from lidarcodec.other_cloud import other_cloud_of, second_returns_of
from lidarcodec.sensors.clouds.points import cloud_points
from lidarcodec.side import Role, SideInfo
from lidarcodec.units import AZIMUTH_STEP_DEG, LASERS_PER_BLOCK

if TYPE_CHECKING:
    from lidarcodec.frame import Frame
    from lidarcodec.sensor_model import SensorModel

Floats = npt.NDArray[np.floating[Any]]

CLOUD_DTYPE = np.dtype(
    [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "u1"), ("laser", "u1"), ("ring", "u1"), ("t_ns", "i8")]
)

NATIVE_FACTORS = (
    "dist", "near_across", "near_along", "cos_rot", "sin_rot", "cos_vert", "sin_vert", "vert_offset", "horiz_offset",
)  # fmt: skip
"""Fields of `_Lasers` in the order in which the native core takes them."""
RETURN = np.dtype([("distance", "<u2"), ("intensity", "u1")])
"""One return in a block, as sent."""
BLOCK_NS = 24_000
"""A block is half a firing of 48 us (S2 manual, laser firing time table). Older firmware takes 24.8 us a block."""
NEAR_ACROSS_M, NEAR_ALONG_M, FAR_M = 2.4, 1.93, 25.04


Returns = Literal["first", "all"]
BOTH_DTYPE = np.dtype([*CLOUD_DTYPE.descr, ("return_number", "u1")])


def cloud_of(frame: Frame, returns: Returns = "first") -> npt.NDArray[np.void]:
    """Points of the frame's valid returns; of `all`, second returns too, and with a field `return_number`.

    (N,) CLOUD_DTYPE or BOTH_DTYPE of an HDL-64E; see `other_cloud` for other sensors. Raises UnknownNameError.
    """
    if returns not in get_args(Returns):
        raise UnknownNameError("choice of returns", str(returns), dict.fromkeys(get_args(Returns)))
    if frame.sensor.is_cloud:
        return cloud_points(frame, both=returns == "all")
    if not frame.sensor.is_hdl64e:
        return other_cloud_of(frame, both=returns == "all")
    first = _first_cloud(frame)
    if returns == "first":
        return first
    both = np.empty(len(first) + len(second := second_cloud(frame)), BOTH_DTYPE)
    for name in CLOUD_DTYPE.names or ():
        both[name] = np.concatenate((first[name], second[name]))
    both["return_number"] = np.repeat((1, 2), (len(first), len(second)))
    return both


def second_returns(frame: Frame) -> int:
    """How many points `cloud_of` has more with `all` than with `first`."""
    if frame.sensor.is_cloud:
        return 0
    if not frame.sensor.is_hdl64e:
        return second_returns_of(frame)
    side = frame.side
    return int(np.count_nonzero(side.second.view(RETURN)["distance"])) if isinstance(side, SideInfo) else 0


def second_returns_text(count: int, remedy: str = "") -> str:
    """Says how many second returns an output lacks. remedy: what would write them"""
    return f"{count:,} second returns left out" + f" ({remedy} writes them)" * bool(remedy)


def cloud_to_show(frame: Frame) -> npt.NDArray[np.void]:
    """`cloud_of` for viewers: empty where the points cannot be known, as of an Ouster without metadata. The note of the
    sensor's calibration says why."""
    try:
        return cloud_of(frame)
    except CalibrationError:
        return np.empty(0, CLOUD_DTYPE)


def _first_cloud(frame: Frame) -> npt.NDArray[np.void]:
    """(N,) CLOUD_DTYPE, points of the frame's valid returns, column by column, each column from the top ring down.

    t_ns is the host time of the column's packet plus the time of the firing within the packet (48 us a firing; its 64
    lasers have one time). In a frame without packets, columns are 48 us apart from its stamp on. The intensity is as
    sent. Second returns are left out: see `second_cloud`. Cost: 2 ms for 120,000 points.
    """
    factors = _factors(frame.sensor, lasers := frame.sensor.laser_of_ring)
    cosine, sine = (values.astype(np.float64, copy=False) for values in _turned(frame.azimuth))
    packed = _native.points_of_returns(
        frame.range,
        None if frame.keep is None else frame.keep.view(np.uint8),
        frame.intensity,
        cosine,
        sine,
        frame.stamp_ns + _column_ns(frame),
        np.stack([getattr(factors, name) for name in NATIVE_FACTORS]),
        lasers.astype(np.uint8),
        factors.range_step,
        factors.turn_offset,
        factors.two_point,
    )
    return packed.view(CLOUD_DTYPE)


def xyz_of(frame: Frame, dtype: type[np.floating[Any]] = np.float64) -> tuple[Floats, Floats, Floats]:
    """x, y, z in metres of every cell, (W, 64) each; values of cells without return are meaningless.

    float32 costs half as much (2 ms) with errors below 0.1 mm.
    """
    lasers = frame.sensor.laser_of_ring
    half = (lasers >= LASERS_PER_BLOCK).astype(np.intp)
    cos_a, sin_a = (values.astype(dtype, copy=False) for values in _turned(frame.azimuth.T))
    # On an S2 both halves of a column fire at one azimuth: one value a column is enough for all its lasers.
    columns = slice(0, 1) if np.array_equal(frame.azimuth[0], frame.azimuth[1]) else half
    factors = _factors(frame.sensor, lasers, dtype)
    return _xyz(frame.range.T.astype(dtype), cos_a[:, columns], sin_a[:, columns], factors)


def second_cloud(frame: Frame) -> npt.NDArray[np.void]:
    """(N,) CLOUD_DTYPE, points of the second returns of a sensor in dual-return mode, in packet order.

    Empty for a frame without side information. Second returns equal to the first return are included.
    Raises SectionError if the side information contradicts the frame.
    """
    side = frame.side
    if not isinstance(side, SideInfo) or not len(side.second):
        return np.empty(0, CLOUD_DTYPE)
    roles = side.layouts[side.layout].ravel()
    opened = np.cumsum(_opens(roles)) - 1
    blocks = np.flatnonzero((roles == Role.UPPER_SECOND) | (roles == Role.LOWER_SECOND))
    column, half = opened[blocks], (roles[blocks] == Role.LOWER_SECOND).astype(np.intp)
    if len(blocks) != len(side.second) or column.min() < 0 or column.max() >= frame.width:
        raise SectionError(f"side information holds {len(side.second)} second returns for {len(blocks)} blocks")
    lasers = half[:, None] * LASERS_PER_BLOCK + np.arange(LASERS_PER_BLOCK)
    returns = side.second.view(RETURN)
    cos_a, sin_a = _turned(frame.azimuth[half, column][:, None])
    xyz = _xyz(returns["distance"], cos_a, sin_a, _factors(frame.sensor, lasers))
    chosen = np.flatnonzero(returns["distance"])
    points = _points(xyz, chosen)
    points["intensity"] = returns["intensity"].ravel()[chosen]
    points["laser"] = lasers.ravel()[chosen]
    points["ring"] = frame.sensor.ring_of_laser[points["laser"]]
    points["t_ns"] = (frame.stamp_ns + _column_ns(frame))[column][chosen // LASERS_PER_BLOCK]
    return points


def _points(xyz: tuple[Floats, Floats, Floats], chosen: npt.NDArray[np.intp]) -> npt.NDArray[np.void]:
    points = np.empty(len(chosen), CLOUD_DTYPE)
    for name, values in zip("xyz", xyz, strict=True):
        points[name] = values.ravel()[chosen]
    return points


def _opens(roles: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    opens: npt.NDArray[np.bool_] = (roles == Role.UPPER_OPENS) | (roles == Role.LOWER_OPENS)
    return opens


def _column_ns(frame: Frame) -> npt.NDArray[np.int64]:
    """(W,) int64, time of each column after the frame's stamp."""
    side = frame.side
    if not isinstance(side, SideInfo) or side.columns != frame.width:
        return np.arange(frame.width, dtype=np.int64) * (2 * BLOCK_NS)
    return side.column_ns + _firing_ns(side)


def _firing_ns(side: SideInfo) -> npt.NDArray[np.int64]:
    """(W,) int64, time of each column after the first block of its packet: 24 us a block, 0 for second returns."""
    takes = (side.layouts != Role.UPPER_SECOND) & (side.layouts != Role.LOWER_SECOND)
    before = (np.cumsum(takes, axis=1) - takes) * BLOCK_NS
    times: npt.NDArray[np.int64] = before[side.layout][_opens(side.layouts)[side.layout]]
    return times


class _Lasers(NamedTuple):
    """Per-laser factors, all of one shape that broadcasts against the points."""

    range_step: float
    turn_offset: bool
    two_point: bool
    dist: Floats
    near_across: Floats
    near_along: Floats
    cos_rot: Floats
    sin_rot: Floats
    cos_vert: Floats
    sin_vert: Floats
    vert_offset: Floats
    horiz_offset: Floats


def _factors(sensor: SensorModel, lasers: npt.NDArray[np.intp], dtype: type[np.floating[Any]] = np.float64) -> _Lasers:
    def of(name: str) -> Floats:
        return sensor.calibration[name][lasers]

    def cast(values: Floats) -> Floats:
        return values.astype(dtype, copy=False)

    rot, vert = of("rot_correction_rad"), of("vert_correction_rad")
    dist, across, along = of("dist_correction_m"), of("dist_correction_x_m"), of("dist_correction_y_m")
    ros = sensor.convention == "ros"
    return _Lasers(
        range_step=sensor.range_step_m,
        turn_offset=ros,
        two_point=ros and not (np.array_equal(dist, across) and np.array_equal(dist, along)),
        dist=cast(dist),
        near_across=cast((across - dist) / (FAR_M - NEAR_ACROSS_M)),
        near_along=cast((along - dist) / (FAR_M - NEAR_ALONG_M)),
        cos_rot=cast(np.cos(rot)),
        sin_rot=cast(np.sin(rot)),
        cos_vert=cast(np.cos(vert)),
        sin_vert=cast(np.sin(vert)),
        vert_offset=cast(of("vert_offset_m")),
        horiz_offset=cast(of("horiz_offset_m")),
    )


def _turned(azimuth: npt.NDArray[np.uint16]) -> tuple[Floats, Floats]:
    """Cosine and sine of azimuths."""
    angle = np.radians(azimuth * AZIMUTH_STEP_DEG)
    return np.cos(angle), np.sin(angle)


def _xyz(ranges: npt.NDArray[Any], cos_a: Floats, sin_a: Floats, k: _Lasers) -> tuple[Floats, Floats, Floats]:
    """x, y, z of native ranges (N, L); cosine and sine of the azimuth and the factors of `k` broadcast to (N, L)."""
    cos_b, sin_b = cos_a * k.cos_rot + sin_a * k.sin_rot, sin_a * k.cos_rot - cos_a * k.sin_rot
    distance = ranges * k.range_step + k.dist
    flat = distance * k.cos_vert
    if k.turn_offset:
        flat -= k.vert_offset * k.sin_vert
    x = flat * cos_b + k.horiz_offset * sin_b
    y = k.horiz_offset * cos_b - flat * sin_b
    z = distance * k.sin_vert + k.vert_offset * (k.cos_vert if k.turn_offset else 1.0)
    if k.two_point:
        across = k.near_across * np.maximum(FAR_M - np.abs(y), 0.0)
        along = k.near_along * np.maximum(FAR_M - np.abs(x), 0.0)
        x += along * k.cos_vert * cos_b
        y -= across * k.cos_vert * sin_b
        z += along * k.sin_vert
    return x, y, z
