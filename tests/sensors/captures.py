"""Packets of the shared captures of other sensors, read with the package's own reader, and clouds that others made."""

from __future__ import annotations

import lzma
from collections import Counter
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lidarcodec.sources.captures.pcap import Ending
from lidarcodec.sources.captures.source import stamped_datagrams

CAPTURES = {
    "vlp16": "sensors/velodyne/vlp16.pcap.xz",
    "vlp16 single": "vlp16_sampleshort.pcap",
    "hdl32e": "hdl32e_monterey_first800.pcap",
    "vlp32c": "sensors/velodyne/vlp32.pcap.xz",
    "vls128": "sensors/velodyne/vls128.pcap.xz",
    "pandar40p": "sensors/hesai/pandar_40p.pcap.xz",
    "pandar64": "sensors/hesai/pandar_64.pcap.xz",
    "qt128": "sensors/hesai/pandar_qt128.pcap.xz",
    "xt16": "sensors/hesai/pandar_xt16.pcap.xz",
    "xt32m": "sensors/hesai/pandar_xt32m.pcap.xz",
    "HDL-64E S3": "hdl64e_s3_atwall.pcap",
    "HDL-64E S2": "kitti_tracking0006_f000-010.pcap.xz",
    "OS-1-128": "sensors/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.pcap.xz",
}
"""Model, and what else tells captures of one model apart -> file in the data folder. The tests of packets, models and
codecs run over all of them; points of a Velodyne are compared with velodyne-decoder."""


def model_of(capture: str) -> str:
    """Name of the model of a capture."""
    return capture.split(maxsplit=1)[0]


def payloads(path: Path) -> list[bytes]:
    """Every UDP payload of a capture."""
    return [datagram.payload for _, datagram in stamped_datagrams(path, Counter(), Ending())]


def data_packets(path: Path) -> npt.NDArray[np.uint8]:
    """(P, bytes) payloads of the most frequent size."""
    found = payloads(path)
    size = Counter(map(len, found)).most_common(1)[0][0]
    chosen = [payload for payload in found if len(payload) == size]
    return np.frombuffer(b"".join(chosen), np.uint8).reshape(len(chosen), size)


def pcd_points(path: Path) -> npt.NDArray[np.float64]:
    """(N, 3) points of a binary `.pcd.xz` of x, y and z in float32."""
    data = lzma.decompress(path.read_bytes())
    start = data.index(b"DATA binary\n") + len(b"DATA binary\n")
    assert b"FIELDS x y z\n" in data[:start]
    return np.frombuffer(data[start:], "<f4").reshape(-1, 3).astype(np.float64)
