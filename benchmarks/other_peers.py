"""Prints, as Markdown, what others make of the frames of sensors beside the HDL-64E, in bits a return.

    python -m benchmarks.other_peers [--cloudini DRIVER] [--save]

Ours is lossless, packets and all. What the others keep:

- "Draco, 1 mm": positions alone, in steps of at most a millimetre, in another order.
- "cloudini, 1 mm": positions in steps of a millimetre, and the attributes and rings of the cloud; no time stamps.
- "OSF": the fields of Ouster's scans as its own software keeps them, each in a PNG, and its faster "ZPNG".

cloudini (facontidavide/cloudini, Apache-2.0) is not in a registry. DRIVER is your own program around it, called as

    DRIVER IN POINT_BYTES RESOLUTION_M OUT NAME:OFFSET:TYPE...

with points as they lie in a PointCloud2. It prints `bytes N`, and writes what it decoded. Without it that column is
left out. OSF is of all scans of a capture, without the metadata of the file. --save writes
benchmarks/results/other-peers.csv.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import DracoPy
import numpy as np
import numpy.typing as npt
from ouster.sdk import core, osf

from benchmarks import results
from benchmarks.other_sensors import Capture, captures, coded
from lidarcodec.assembly import packets_of
from lidarcodec.frame import Frame
from lidarcodec.sensors.models.table import OUSTERS

STEP_M: Final = 0.001
NOT_SENT: Final = ("laser", "t_ns")
"""Fields of a cloud that no peer gets: time stamps, and the laser, which the ring tells."""
TYPES: Final = {"f4": "FLOAT32", "u1": "UINT8", "u2": "UINT16"}
PNG_LEVEL: Final = 4
ZPNG_LEVEL: Final = 1

Cloud = npt.NDArray[np.void]


def cloud_of(frame: Frame) -> Cloud:
    """First and second returns of a frame, packed: x y z in metres, attributes, ring and number of the return."""
    cloud = frame.cloud(returns="all")
    kept = [name for name in cloud.dtype.names or () if name not in NOT_SENT]
    packed = np.empty(len(cloud), [(name, cloud.dtype[name]) for name in kept])
    for name in kept:
        packed[name] = cloud[name]
    return packed


def draco(cloud: Cloud) -> int:
    """Bytes of the positions."""
    points = np.stack([cloud[axis] for axis in "xyz"], axis=1).astype(np.float32)
    side_m = float(np.ptp(points, axis=0).max())
    bits = int(np.ceil(np.log2(side_m / STEP_M)))
    return len(DracoPy.encode(points, quantization_bits=bits, compression_level=10, preserve_order=False))


def cloudini(driver: Path, cloud: Cloud) -> int:
    """Bytes of a whole cloud. Raises AssertionError if a coordinate comes back more than a step off."""
    fields = cloud.dtype.fields or {}
    words = [f"{name}:{of[1]}:{TYPES[of[0].str[1:]]}" for name, of in fields.items()]
    with tempfile.TemporaryDirectory() as name:
        given, back = Path(name) / "in", Path(name) / "out"
        cloud.tofile(given)
        command = [driver, given, str(cloud.dtype.itemsize), str(STEP_M), back, *words]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        decoded = np.fromfile(back, cloud.dtype)
    for axis in "xyz":
        assert np.abs(decoded[axis] - cloud[axis]).max() <= STEP_M, axis
    return int(said.split()[-1])


def osf_of(frames: list[Frame], encoder: Any) -> int:
    """Bytes that these scans add to a file of Ouster's own software."""
    info = core.SensorInfo(frames[0].sensor.description.decode())
    sizes = []
    for count in (1, 1 + len(frames)):  # the first scan comes with the metadata of the file
        with tempfile.TemporaryDirectory() as name:
            path = Path(name) / "scans.osf"
            with osf.Writer(str(path), info, [], 0, osf.Encoder(encoder)) as writer:
                for frame in (frames[:1] + frames)[:count]:
                    writer.save(0, _scan(frame, info))
            sizes.append(path.stat().st_size)
    return sizes[1] - sizes[0]


def _scan(frame: Frame, info: Any) -> Any:
    scan, batcher, form = core.LidarFrame(info), core.FrameBatcher(info), core.PacketFormat(info)
    for packet in packets_of(frame):
        if packet.position:
            continue
        one = core.LidarPacket(form)
        one.buf[:] = np.frombuffer(packet.payload, np.uint8)
        batcher.batch(one, scan)
    return scan


def table(driver: Path | None) -> str:
    """The table. driver: the program around cloudini, if there is one"""
    peers: dict[str, Callable[[Capture], int | None]] = {
        "Draco, 1 mm": lambda capture: sum(draco(cloud_of(frame)) for frame in capture.frames),
        "OSF, PNG": lambda capture: _osf(capture, osf.PngLidarFrameEncoder(PNG_LEVEL)),
        "OSF, ZPNG": lambda capture: _osf(capture, osf.ZPngLidarFrameEncoder(ZPNG_LEVEL)),
    }
    if driver is not None:
        peers["cloudini, 1 mm"] = lambda capture: sum(cloudini(driver, cloud_of(frame)) for frame in capture.frames)
    heads = ["`predictive`, lossless", *peers]
    lines = [f"| sensor | {' | '.join(heads)} |", "|---|" + "---:|" * len(heads)]
    for capture in captures():
        bits = 8 / capture.returns
        sizes = [coded(capture, "predictive").size, *(peer(capture) for peer in peers.values())]
        lines.append(f"| {capture.name} | {' | '.join('-' if n is None else f'{n * bits:.2f}' for n in sizes)} |")
    return "\n".join(lines)


def _osf(capture: Capture, encoder: Any) -> int | None:
    return osf_of(capture.frames, encoder) if capture.frames[0].sensor.model in OUSTERS else None


def main() -> None:
    """Print the table, and with --save keep it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cloudini", type=Path, metavar="DRIVER", help="your program around cloudini")
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/other-peers.csv")
    given = parser.parse_args()
    text = table(given.cloudini)
    print(text)
    if given.save:
        results.save("other-peers", text, title="Other sensors: what others make of the same frames, bits a return")


if __name__ == "__main__":
    main()
