"""Masks, rotations and side information for the entropy coders: made from seeds, or of real captures."""

from __future__ import annotations

import lzma
from functools import cache
from pathlib import Path

import numpy as np
import yaml

from lidarcodec.assembly import Assembler
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.sensor_model import Calibration, SensorModel
from lidarcodec.side import SideInfo


def sensor(seed: int = 0) -> SensorModel:
    """An HDL-64E: upper block above the lower, lasers of a firing up to 18 degrees apart."""
    rng = np.random.default_rng(seed)
    return SensorModel(
        "HDL-64E",
        Calibration.from_values(
            {
                "vert_correction_rad": np.linspace(0.035, -0.43, 64),
                "rot_correction_rad": rng.uniform(-0.16, 0.16, 64).round(6) + rng.choice([-np.pi, np.pi], 64),
            }
        ),
    )


def mask(width: int, seed: int = 1) -> np.ndarray:
    """(64, W) bool with holes as real ones have them: patches of some columns, and single cells."""
    rng = np.random.default_rng(seed)
    gone = rng.random((64, width)) < 0.02
    for row, column in zip(rng.integers(0, 64, width // 4), rng.integers(0, width, width // 4), strict=True):
        gone[row : row + int(rng.integers(1, 6)), column : column + int(rng.integers(1, 30))] = True
    return ~gone


def all_fired(width: int) -> np.ndarray:
    """(2, W) bool of an S2 in single-return mode."""
    return np.ones((2, width), np.bool_)


def one_in_three(width: int) -> np.ndarray:
    """(2, W) bool of the S3 capture: three upper blocks for one lower."""
    return np.array([np.ones(width), np.arange(width) % 3 == 0], np.bool_)


@cache
def packets(path: Path, count: int) -> tuple[Packet, ...]:
    """The first `count` sensor packets of a pcap (also .xz), read here so that these tests need no source."""
    size = 24 + count * 1300
    if path.suffix == ".xz":
        with lzma.open(path) as file:
            data = file.read(size)
    else:
        data = path.read_bytes()[:size]
    found, at = [], 24
    while at + 16 <= len(data) and len(found) < count:
        seconds, micros, length, _ = np.frombuffer(data, "<u4", 4, at).tolist()
        body = data[at + 58 : at + 16 + length]
        if len(body) == 1206:
            found.append(Packet(body, seconds * 10**9 + micros * 1000))
        at += 16 + length
    return tuple(found)


def frames(path: Path, calibration: Path, count: int) -> list[Frame]:
    """The first `count` frames of a capture, with the calibration of a ROS yaml file."""
    table = {"vert_correction_rad": np.zeros(64), "rot_correction_rad": np.zeros(64)}
    for laser in yaml.safe_load(calibration.read_text())["lasers"]:
        table["vert_correction_rad"][laser["laser_id"]] = laser["vert_correction"]
        table["rot_correction_rad"][laser["laser_id"]] = laser["rot_correction"]
    assembler = Assembler(SensorModel("HDL-64E", Calibration.from_values(table)))
    pushed = [*(assembler.push(packet) for packet in packets(path, 348 * count)), assembler.flush()]
    return [frame for frame in pushed if frame is not None]


def s2_side(jitter_ns: int = 1000, seed: int = 1, packets: int = 348) -> SideInfo:
    """Side information like a real S2's: status in cycles of 16 with calibration bytes, a packet in 288 us, jitter."""
    rng = np.random.default_rng(seed)
    cycle = np.frombuffer(b"HMSDNYGTV1234567", np.uint8)
    types = np.resize(cycle, packets)
    values = np.where(np.isin(types, cycle[9:]), rng.integers(0, 256, packets), types).astype(np.uint8)
    stamps = np.arange(packets) * 288_000 + rng.integers(-jitter_ns, jitter_ns + 1, packets)
    regular = SideInfo.regular(packets)
    return SideInfo(
        packet_ns=(stamps - stamps[:1]).astype(np.int64),
        gps_us=((3_599_990_000 + np.arange(packets) * 288) % 3_600_000_000).astype(np.uint32),
        status=np.stack([types, values], axis=1),
        layouts=regular.layouts,
        layout=regular.layout,
        irregular=regular.irregular,
        second=regular.second,
    )


def same_side(a: SideInfo, b: SideInfo) -> bool:
    """Whether two hold the same."""
    names = ("packet_ns", "gps_us", "status", "layouts", "layout", "irregular", "second")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)
