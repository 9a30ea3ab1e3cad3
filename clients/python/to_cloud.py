"""The points of a live stream as numpy arrays: prints what is near the car, once a second.

python clients/python/to_cloud.py [VEHICLE/SENSOR] [--connect tcp/HOST:7447] [--seconds 10]
"""

import argparse
import signal
import sys
import time

import numpy as np

import lidarcodec


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", nargs="?", default="vehicle/lidar")
    parser.add_argument("--connect", action="append", help="Zenoh endpoint; without one, this machine only")
    parser.add_argument("--seconds", type=float, default=10.0, help="of frames, from the first one on")
    options = parser.parse_args()

    with lidarcodec.subscribe(options.stream, connect=options.connect) as live:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: live.interrupt())
        first = said = float("-inf")
        for frame in live:
            now = time.monotonic()
            first = now if first < 0 else first
            if now - said >= 1.0:
                said = now
                cloud = frame.cloud()
                above_road = cloud[cloud["z"] > -1.2]
                distance = np.hypot(above_road["x"], above_road["y"])
                nearest = f"{distance.min():.1f} m" if len(distance) else "nothing"
                print(f"frame {frame.index}: {len(cloud)} points, nearest above the road: {nearest}", flush=True)
            if now - first >= options.seconds:
                break


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        pass
    except (lidarcodec.LidarCodecError, OSError) as error:
        sys.exit(f"to_cloud: {error}")
