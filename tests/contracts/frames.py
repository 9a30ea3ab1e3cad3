"""Small frames that ask of a codec all that real ones ask, made from seeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.settings import StreamSettings
from lidarcodec.side import Role, SideInfo
from lidarcodec.units import FIRINGS_PER_PACKET, LASERS
from tests import positions


def sensor(seed: int = 0) -> SensorModel:
    """A sensor whose lasers look like an HDL-64E's: 0-31 in the upper block, elevations of both blocks interleaved."""
    rng = np.random.default_rng(seed)
    elevation = np.concatenate([np.linspace(0.035, -0.145, 32), np.linspace(-0.154, -0.43, 32)])
    return SensorModel(
        "HDL-64E",
        Calibration.from_values(
            {
                "vert_correction_rad": elevation,
                "rot_correction_rad": rng.uniform(-0.15, 0.15, 64).round(6),
                "dist_correction_m": rng.uniform(0.8, 1.2, 64).round(4),
            }
        ),
    )


SENSOR = sensor()


def scene(packets: int, seed: int = 1, index: int = 0, holes: float = 0.15, **changes: object) -> Frame:
    """Smooth rows with steps, noise and no-return cells; six whole firings a packet, no-return intensity 0."""
    rng = np.random.default_rng([seed, index])
    width = packets * FIRINGS_PER_PACKET
    walls = np.cumsum(rng.choice([0, 0, 0, 0, 0, 0, 900, -700], (LASERS, width)), axis=1)
    ranges = np.clip(4000 + 150 * np.arange(LASERS)[:, None] + walls + rng.integers(-5, 6, (LASERS, width)), 500, 65535)
    gone = rng.random((LASERS, width)) < holes
    intensity = np.clip(60 + np.cumsum(rng.integers(-4, 5, (LASERS, width)), axis=1), 0, 255)
    turn = (index * width * 17 + np.arange(width) * 17) % 36000
    values: dict[str, object] = {
        "index": index,
        "stamp_ns": 1_700_000_000_000_000_000 + index * 100_000_000,
        "range": np.where(gone, 0, ranges).astype(np.uint16),
        "intensity": np.where(gone, 0, intensity).astype(np.uint8),
        "azimuth": np.tile(turn.astype(np.uint16), (2, 1)),
        "fired": np.ones((2, width), np.bool_),
        "sensor": SENSOR,
        "side": SideInfo.regular(packets),
    }
    return Frame(**(values | changes))  # type: ignore[arg-type]


def noise(packets: int, seed: int = 2, index: int = 0) -> Frame:
    """A frame without any structure, with an intensity in every cell."""
    rng = np.random.default_rng([seed, index])
    width = packets * FIRINGS_PER_PACKET
    ranges = rng.integers(0, 65536, (LASERS, width)).astype(np.uint16)
    intensity = rng.integers(0, 256, (LASERS, width)).astype(np.uint8)
    return scene(packets, index=index, range=ranges, intensity=intensity)


def three_to_one(packets: int, index: int = 0) -> Frame:
    """A frame as the real S3 sends it: one lower block, then three upper ones, none of them in a common column."""
    roles = np.array([[Role.LOWER_OPENS, Role.UPPER_OPENS, Role.UPPER_OPENS, Role.UPPER_OPENS] * 3], np.uint8)
    regular = SideInfo.regular(packets)
    side = SideInfo(
        packet_ns=regular.packet_ns.copy(),
        gps_us=np.full(packets, 0x6544204F, np.uint32),
        status=np.tile(np.array([[103, 67]], np.uint8), (packets, 1)),
        layouts=roles,
        layout=np.zeros(packets, np.uint16),
        irregular=np.zeros((0, 100), np.uint8),
        second=np.zeros((0, 96), np.uint8),
    )
    base = scene(2 * packets, seed=3, index=index)
    lower = np.tile([True, False, False, False], 3 * packets)
    fired = np.stack([~lower, lower])
    cells = fired[(SENSOR.laser_of_ring >= 32).astype(int)]
    return base.with_(
        range=np.where(cells, base.range, 0).astype(np.uint16),
        intensity=np.where(cells, np.maximum(base.intensity, 7), 0).astype(np.uint8),
        fired=fired,
        side=side,
    )


def one_return(packets: int = 1) -> Frame:
    """A frame with a single return."""
    empty = scene(packets, holes=1.0)
    ranges, intensity = empty.range.copy(), empty.intensity.copy()
    ranges[17, 2], intensity[17, 2] = 1, 200
    return empty.with_(range=ranges, intensity=intensity)


def irregular_side(packets: int) -> Frame:
    """A frame whose side information uses every part: odd blocks, second returns, jumping stamps, status bytes."""
    rng = np.random.default_rng(4)
    layouts = np.array([[1, 4] * 6, [0] * 12, [1, 4, 5, 6] * 3], np.uint8)
    layout = rng.permutation(np.arange(packets) % 3).astype(np.uint16)
    blocks = layouts[layout]
    side = SideInfo(
        packet_ns=rng.integers(-(2**60), 2**60, packets),
        gps_us=rng.integers(0, 2**32, packets).astype(np.uint32),
        status=rng.integers(0, 256, (packets, 2)).astype(np.uint8),
        layouts=layouts,
        layout=layout,
        irregular=rng.integers(0, 256, (int((blocks == 0).sum()), 100)).astype(np.uint8),
        second=rng.integers(0, 256, (int((blocks >= 5).sum()), 96)).astype(np.uint8),
    )
    base = scene(packets)
    cut = {name: getattr(base, name)[:, : side.columns].copy() for name in ("range", "intensity", "azimuth", "fired")}
    return base.with_(side=side, **cut)


def with_positions(packets: int) -> SideInfo:
    """Side information with position packets at every kind of place."""
    return replace(SideInfo.regular(packets), positions=positions.of_frame(packets))


def pose(seed: int = 5) -> np.ndarray:
    """A rigid transform."""
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = turn, [10.0, -3.0, 1.5]
    return whole


def received(frame: Frame, reduction: str) -> Frame:
    """The frame as a receiver has it, without loss but for the returns that a reduction leaves out."""
    (message,) = StreamEncoder(StreamSettings(reduction=reduction), 1).encode(frame)
    (back,) = StreamDecoder().decode(message)
    return back


def ordinary() -> dict[str, Frame]:
    """Frames by what is special about them; each must come back exactly from a lossless codec."""
    base = scene(8)
    rng = np.random.default_rng(6)
    blank = {"side": None, "range": base.range[:, :0], "intensity": base.intensity[:, :0]}
    full = np.full_like(base.range, 65535)
    odd = {name: getattr(base, name)[:, :7] for name in ("range", "intensity", "azimuth", "fired")}
    return {
        "ordinary": base,
        "empty": base.with_(azimuth=base.azimuth[:, :0], fired=base.fired[:, :0], **blank),
        "no packets": base.with_(
            azimuth=base.azimuth[:, :0], fired=base.fired[:, :0], **(blank | {"side": SideInfo.regular(0)})
        ),
        "no return": scene(3, holes=1.0),
        "one return": one_return(),
        "all valid": scene(5, holes=0.0),
        "all maximum": base.with_(range=full, intensity=np.full_like(base.intensity, 255)),
        "all minimum": base.with_(range=np.ones_like(base.range)),
        "noise": noise(6),
        "one column": base.with_(side=None, **{name: array[:, :1] for name, array in odd.items()}),
        "odd width": base.with_(side=None, **odd),
        "one packet": scene(1),
        "three to one": three_to_one(5),
        "irregular packets": irregular_side(9),
        "intensity without return": base.with_(intensity=rng.integers(0, 256, base.range.shape).astype(np.uint8)),
        "pose": base.with_(pose=pose()),
        "no side": base.with_(side=None),
        "veloview": base.with_(sensor=SENSOR.with_convention("veloview")),
        "position packets": base.with_(side=with_positions(8)),
        "nothing but position packets": base.with_(
            azimuth=base.azimuth[:, :0], fired=base.fired[:, :0], **(blank | {"side": with_positions(0)})
        ),
        "early stamp": base.with_(stamp_ns=-5),
    }
