"""The points of a live stream out of the server's cloud socket, by docs/live-sockets.md alone; without lidarcodec.

python clients/python/live_cloud.py [VEHICLE/SENSOR] [--server http://127.0.0.1:8080] [--form range] [--seconds 10]
    [--token TOKEN]

Needs numpy and websockets. Prints a line a second.
"""

import argparse
import json
import math
import struct
import time
from typing import Any

import numpy as np
from websockets.sync.client import connect

HEADER = struct.Struct("<4s2H2Q2q2H3If4f2HI")
FIELDS = [
    "magic",
    "version",
    "header_bytes",
    "stream_id",
    "frame_index",
    "stamp_ns",
    "decoded_ns",
    "codec",
    "flags",
    "count",
    "returns",
    "missing",
    "latency_ms",
    "scale_m",
    "offset_x_m",
    "offset_y_m",
    "offset_z_m",
    "columns",
    "rings",
    "total_bytes",
]
INTENSITY, RING, RANGE, ORIGINAL, FILLED = 1, 2, 4, 16, 64


def read_message(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header fields and arrays of a binary message."""
    if len(data) < HEADER.size:
        raise ValueError(f"{len(data)} bytes are no frame")
    head = dict(zip(FIELDS, HEADER.unpack_from(data), strict=True))
    if head["magic"] not in (b"LDCP", b"LDCR") or head["version"] != 1 or head["total_bytes"] != len(data):
        raise ValueError("not a frame of format version 1")
    cells = head["rings"] * head["columns"]
    if head["magic"] == b"LDCP":
        wanted = [(axis, "<i2", head["count"]) for axis in "xyz"]
        kinds = (
            (INTENSITY, "intensity", "u1"),
            (RING, "ring", "u1"),
            (RANGE, "range", "<u2"),
            (FILLED, "filled", "u1"),
        )
        for flag, name, kind in kinds:
            if head["flags"] & flag:
                wanted.append((name, kind, head["count"]))
    else:
        wanted = [("range", "<u2", cells), ("azimuth", "<u2", 2 * head["columns"])]
        if head["flags"] & INTENSITY:
            wanted.append(("intensity", "u1", cells))
        if head["flags"] & ORIGINAL:
            wanted.append(("original", "<u2", cells))
        if head["flags"] & FILLED:
            wanted.append(("filled", "u1", cells))
    arrays, at = {}, head["header_bytes"]
    for name, kind, number in wanted:
        arrays[name] = np.frombuffer(data, kind, number, at)
        at += (arrays[name].nbytes + 3) // 4 * 4
    return head, arrays


def points_of(head: dict[str, Any], arrays: dict[str, np.ndarray]) -> np.ndarray:
    """(N, 3) metres of a message of form points."""
    steps = np.stack([arrays[axis] for axis in "xyz"], axis=1)
    return steps * head["scale_m"] + [head["offset_x_m"], head["offset_y_m"], head["offset_z_m"]]


def points_of_range(head: dict[str, Any], arrays: dict[str, np.ndarray], sensor: dict[str, Any]) -> np.ndarray:
    """(N, 3) metres of a message of form range. sensor: the last `sensor` event."""
    ranges = arrays["range"].reshape(head["rings"], head["columns"])
    azimuth = arrays["azimuth"].reshape(2, head["columns"])
    ring, column = np.nonzero(ranges)

    def of(name: str) -> np.ndarray:
        return np.array(sensor[name])[ring]

    beta = np.radians(azimuth[of("block"), column] * 0.01) - of("rot_correction_rad")
    elevation, across_m = of("vert_correction_rad"), of("horiz_offset_m")
    distance = ranges[ring, column] * sensor["range_step_m"] + of("dist_correction_m")
    ros = sensor["convention"] == "ros"
    flat = distance * np.cos(elevation) - (of("vert_offset_m") * np.sin(elevation) if ros else 0.0)
    x = flat * np.cos(beta) + across_m * np.sin(beta)
    y = across_m * np.cos(beta) - flat * np.sin(beta)
    z = distance * np.sin(elevation) + of("vert_offset_m") * (np.cos(elevation) if ros else 1.0)
    if ros:
        far, near_x, near_y = of("dist_correction_m"), of("dist_correction_x_m"), of("dist_correction_y_m")
        along = (near_y - far) / (25.04 - 1.93) * np.maximum(25.04 - np.abs(x), 0.0)
        sideways = (near_x - far) / (25.04 - 2.4) * np.maximum(25.04 - np.abs(y), 0.0)
        x = x + along * np.cos(elevation) * np.cos(beta)
        y = y - sideways * np.cos(elevation) * np.sin(beta)
        z = z + along * np.sin(elevation)
    return np.stack([x, y, z], axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", nargs="?", default="vehicle/lidar")
    parser.add_argument("--server", default="http://127.0.0.1:8080")
    parser.add_argument("--form", choices=("points", "range"), default="points")
    parser.add_argument("--seconds", type=float, default=10.0, help="of frames, from the first one on")
    parser.add_argument("--token", help="where the server wants one")
    options = parser.parse_args()

    url = f"ws{options.server.removeprefix('http')}/api/v1/streams/{options.stream}/cloud?form={options.form}"
    headers = {"Authorization": f"Bearer {options.token}"} if options.token else None
    sensor: dict[str, Any] = {}
    first = said = -math.inf
    with connect(url, additional_headers=headers, compression=None, max_size=2**24) as socket:
        for message in socket:
            if isinstance(message, str):
                event = json.loads(message)
                sensor = event if event["event"] == "sensor" else sensor
                print(f"event: {event['event']}", flush=True)
                continue
            head, arrays = read_message(message)
            socket.send(struct.pack("<Q", head["frame_index"]))  # only now will the next one come
            now = time.monotonic()
            first = now if first < 0 else first
            if now - said >= 1.0:
                said = now
                ranged = head["magic"] == b"LDCR"
                points = points_of_range(head, arrays, sensor) if ranged else points_of(head, arrays)
                high = points[points[:, 2] > -1.2]
                nearest = f"{np.hypot(high[:, 0], high[:, 1]).min():.1f} m" if len(high) else "nothing"
                made_up = f" and {head['count'] - head['returns']} made up" if "filled" in arrays else ""
                print(
                    f"frame {head['frame_index']}: {head['returns']} points{made_up}, {head['latency_ms']:.0f} ms old"
                    f" at the server, nearest above the road: {nearest}",
                    flush=True,
                )
            if now - first >= options.seconds:
                break


if __name__ == "__main__":
    main()
