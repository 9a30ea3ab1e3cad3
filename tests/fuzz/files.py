"""Damaged files: captures, plain and compressed, recordings, and bags of ROS 2."""

from __future__ import annotations

import io
import lzma
import random
import tempfile
from collections.abc import Callable
from pathlib import Path

import zstandard

from lidarcodec.interop.velodyne_scan import packets_of_scan, scan_of
from lidarcodec.pipeline import StreamEncoder, frames_of
from lidarcodec.recording import RecordingReader, RecordingWriter, RosbagWriter
from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from lidarcodec.wire import pack
from tests.fuzz.mutations import mutated
from tests.packets import packets_in, sensor, turning

Case = tuple[bytes, Callable[[bytes], object]]


def capture_target() -> Callable[[random.Random], Case]:
    """Damaged pcap files, as they are and compressed; every prefix length comes up sooner or later."""
    buffer = io.BytesIO()
    PcapWriter(buffer).write_all(turning(20))
    plain = buffer.getvalue()
    forms = {
        ".pcap": plain,
        ".pcap.zst": zstandard.ZstdCompressor().compress(plain),
        ".pcap.xz": lzma.compress(plain, preset=0),
    }
    folder = tempfile.TemporaryDirectory(prefix="lidarcodec-fuzz-")

    def case(rng: random.Random) -> Case:
        suffix = rng.choice(list(forms))
        clean = forms[suffix]
        data = clean[: rng.randrange(len(clean))] if rng.random() < 0.3 else mutated(clean, rng)

        def read(damaged: bytes) -> None:
            path = Path(folder.name) / f"damaged{suffix}"
            path.write_bytes(damaged)
            with open_source(path) as source:
                list(frames_of(source.packets(), source.sensor))

        return data, read

    return case


def recording_target() -> Callable[[random.Random], Case]:
    """Damaged and cut recordings, of messages and of raw packets."""
    buffer = io.BytesIO()
    with RecordingWriter(buffer, vehicle="v", sensor="s") as writer:
        encoder = StreamEncoder(stream_id=1)
        for frame in frames_of(turning(12), sensor(), "packets:3"):
            for message in encoder.encode(frame):
                writer.write(pack(message))
        writer.write_packets(turning(3))
    clean = buffer.getvalue()

    def case(rng: random.Random) -> Case:
        data = clean[: rng.randrange(len(clean))] if rng.random() < 0.3 else mutated(clean, rng)

        def read(damaged: bytes) -> None:
            reader = RecordingReader(io.BytesIO(damaged))
            list(reader.messages())
            list(reader.messages(start_ns=turning(12)[7].stamp_ns))
            list(reader.packets())

        return data, read

    return case


def rosbag_target() -> Callable[[random.Random], Case]:
    """Damaged and cut bags, and damaged messages of them."""
    buffer = io.BytesIO()
    with RosbagWriter(buffer) as writer:
        writer.write_scan(turning(3))
        writer.write_scan(turning(2))
    clean, scan = buffer.getvalue(), scan_of(turning(4), "velodyne")
    folder = tempfile.TemporaryDirectory(prefix="lidarcodec-fuzz-")

    def case(rng: random.Random) -> Case:
        if rng.random() < 0.5:
            return (scan[: rng.randrange(len(scan))] if rng.random() < 0.3 else mutated(scan, rng)), packets_of_scan
        data = clean[: rng.randrange(len(clean))] if rng.random() < 0.3 else mutated(clean, rng)

        def read(damaged: bytes) -> None:
            path = Path(folder.name) / "damaged.mcap"
            path.write_bytes(damaged)
            packets_in(path)

        return data, read

    return case
