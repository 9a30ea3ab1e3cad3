"""A live stream into a capture: the sensor's own packets, as any Velodyne tool reads them.

python clients/python/to_pcap.py OUT.pcap [VEHICLE/SENSOR] [--connect tcp/HOST:7447] [--seconds 10]
"""

import argparse
import signal
import sys
import time
from pathlib import Path

import lidarcodec
from lidarcodec.sources.captures.pcap_writer import PcapWriter


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("stream", nargs="?", default="vehicle/lidar")
    parser.add_argument("--connect", action="append", help="Zenoh endpoint; without one, this machine only")
    parser.add_argument("--seconds", type=float, default=10.0, help="of frames, from the first one on")
    options = parser.parse_args()

    with options.out.open("wb") as file, lidarcodec.subscribe(options.stream, connect=options.connect) as live:
        for number in (signal.SIGINT, signal.SIGTERM):  # enough: the frame that is being written is ended
            signal.signal(number, lambda *_: live.interrupt())
        capture, packets, until = PcapWriter(file), 0, float("inf")
        for frame in live:
            packets += capture.write_all(lidarcodec.packets_of(frame))
            until = min(until, time.monotonic() + options.seconds)
            if time.monotonic() >= until:
                break
    print(f"{packets} packets in {options.out}; {live.summary().get('missing', 0)} frames were replaced on the way")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        pass
    except (lidarcodec.LidarCodecError, OSError) as error:
        sys.exit(f"to_pcap: {error}")
