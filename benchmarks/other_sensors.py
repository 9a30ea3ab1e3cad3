"""Prints, as Markdown, what lossless frames of sensors beside the HDL-64E cost, capture by capture.

    python -m benchmarks.other_sensors [--save]

The captures are those in `sensors/` of the data folder: a few turns of each sensor, at rest. Bits are of whole
messages, everything counted, over first and second returns; each frame is coded alone. "Packets, xz" compresses the
packets of a frame as they are. "Rows, xz" is what a plain image coder gets: differences along the rows of each plane,
byte by byte, through xz, without the time stamps. Times are of one frame, from packets to bytes and from bytes to
packets, on one core.

--save writes benchmarks/results/other-sensors.csv.
"""

from __future__ import annotations

import argparse
import lzma
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks import results
from benchmarks.scenes import DATA
from lidarcodec.assembly import packets_of
from lidarcodec.frame import Frame
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import settings_from
from lidarcodec.sources import open_source
from lidarcodec.wire import pack, unpack

COMPARED = ("pcodec", "predictive")
"""Codecs beside which their difference to "rows, xz" stands."""
XZ_LEVEL = 6


class Capture(NamedTuple):
    """Whole turns of a capture."""

    name: str
    frames: list[Frame]

    @property
    def returns(self) -> int:
        """First and second returns."""
        return sum(
            frame.points + sum(int(np.count_nonzero(frame.planes[name])) for name in frame.planes if name == "range2")
            for frame in self.frames
        )


def captures() -> list[Capture]:
    """Every capture of a sensor beside the HDL-64E, with points. First and last turns are parts: they are left out."""
    found = []
    for path in sorted((DATA / "sensors").glob("*/*.pcap*")):
        with open_source(path) as source:
            frames = list(frames_of(source.packets(), source.sensor, "revolution"))
            name = source.sensor.name
        whole = frames[1:-1] if len(frames) > 2 else frames
        if max(frame.width for frame in whole) >= 256:  # not one of a few packets
            found.append(Capture(f"{name} ({_stem(path)})", whole))
    return found


def _stem(path: Path) -> str:
    return path.name.split(".pcap")[0][:24]


def packets_xz(frame: Frame) -> int:
    """Bytes of a frame's packets through xz."""
    return len(lzma.compress(b"".join(p.payload for p in packets_of(frame) if not p.position), preset=XZ_LEVEL))


def rows_xz(frame: Frame) -> int:
    """Bytes of differences along the rows of all planes, byte by byte, through xz."""
    return sum(map(plane_xz, (frame.range, frame.intensity, *frame.planes.values())))


def plane_xz(plane: npt.NDArray[np.unsignedinteger]) -> int:
    """Bytes of differences along the rows of a plane, byte by byte, through xz."""
    steps = np.ascontiguousarray(np.diff(plane, axis=1, prepend=plane.dtype.type(0)))
    size = steps.dtype.itemsize
    return len(lzma.compress(steps.view(np.uint8).reshape(-1, size).T.tobytes(), preset=XZ_LEVEL))


class Coded(NamedTuple):
    """Bytes of all messages, and the quickest frame there and back, in milliseconds."""

    size: int
    encode_ms: float
    decode_ms: float


def coded(capture: Capture, codec: str) -> Coded:
    """What a codec makes of each frame alone. Raises AssertionError if a packet does not come back."""
    size, there, back = 0, [], []
    for frame in capture.frames:
        packets = packets_of(frame)
        started = process_time()
        (again,) = frames_of([Packet(*packet) for packet in packets], frame.sensor, "packets:2048")
        encoder = StreamEncoder(settings_from({"codec": codec}))
        messages = [pack(message) for message in encoder.encode(again)]
        there.append(process_time() - started)
        size += sum(map(len, messages))
        decoder = StreamDecoder()
        started = process_time()
        came = [packet for data in messages for one in decoder.decode(unpack(data)) for packet in packets_of(one)]
        back.append(process_time() - started)
        assert [packet.payload for packet in came] == [packet.payload for packet in packets]
    return Coded(size, min(there) * 1e3, min(back) * 1e3)


def table() -> str:
    """The table."""
    heads = ["packets, xz", "rows, xz", "`zstd`"]
    heads += [head for codec in COMPARED for head in (f"`{codec}`", "less than rows", "ms there / back")]
    lines = [f"| sensor | returns a turn | raw | {' | '.join(heads)} |", "|---|" + "---|" * (len(heads) + 2)]
    for capture in captures():
        bits = 8 / capture.returns
        raw = sum(len(packet.payload) for frame in capture.frames for packet in packets_of(frame)) * bits
        rows = sum(map(rows_xz, capture.frames)) * bits
        cells = [f"{capture.returns / len(capture.frames):,.0f}", f"{raw:.1f}"]
        cells += [f"{sum(map(packets_xz, capture.frames)) * bits:.2f}", f"{rows:.2f}"]
        cells.append(f"{coded(capture, 'zstd').size * bits:.2f}")
        for codec in COMPARED:
            found = coded(capture, codec)
            cells += [f"{found.size * bits:.2f}", f"{100 * (1 - found.size * bits / rows):.0f} %"]
            cells.append(f"{found.encode_ms:.0f} / {found.decode_ms:.0f}")
        lines.append(f"| {capture.name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table, and with --save keep it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--save", action="store_true", help="into benchmarks/results/other-sensors.csv")
    given = parser.parse_args()
    text = table()
    print(text)
    if given.save:
        results.save("other-sensors", text, title="Other sensors: bits a return, lossless")


if __name__ == "__main__":
    main()
