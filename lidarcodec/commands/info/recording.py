"""`lidarcodec info FILE.mcap`: the contents of a recording, or one of its messages byte by byte."""

from __future__ import annotations

import math
import sys
from collections import Counter
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from lidarcodec.commands.info.explain import codec_name, explain, section_name, time_text
from lidarcodec.commands.unkept import positions_of
from lidarcodec.errors import CalibrationError, DecodeError, SettingsError
from lidarcodec.evaluation.sent import Sent
from lidarcodec.files.regular import open_regular
from lidarcodec.message import Message
from lidarcodec.planes.other_calibrations import Described
from lidarcodec.recording import RecordingReader
from lidarcodec.recording.holes import Numbers
from lidarcodec.sensors import find_sensor
from lidarcodec.sensors.recognise import STREAM_PACKETS, recognised
from lidarcodec.sources.described import without_text
from lidarcodec.sources.recording import sensor_of_packets
from lidarcodec.units import counted
from lidarcodec.wire import unpack

SHOWN_MESSAGES = 20


class _Messages:
    """Totals of messages, and a row for each of the first ones.

    count, size: of messages and their bytes;  codecs, sections: how often, and how many bytes, by name
    positions: position packets in them
    """

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.sections: Counter[str] = Counter()
        self.codecs: Counter[str] = Counter()
        self.count = self.size = self.keys = self.damaged = self.positions = 0
        self.sent, self.numbers = Sent(), Numbers()

    def add(self, data: bytes) -> None:
        """Take the next message."""
        try:
            message = unpack(data)
        except DecodeError as error:
            self.damaged += 1
            row: dict[str, Any] = {"n": self.count, "damaged": str(error)}
        else:
            row = self._row(message, len(data))
        if len(self.rows) < SHOWN_MESSAGES:
            self.rows.append(row)
        self.count, self.size = self.count + 1, self.size + len(data)

    def _row(self, message: Message, size: int) -> dict[str, Any]:
        sizes: Counter[str] = Counter()
        for section in message.sections:
            sizes[section_name(section.type)] += len(section.data)
            self.positions += positions_of(section)
        with suppress(DecodeError):
            self.sent.add(message)
        codec = codec_name(message.codec)
        self.sections += sizes
        self.codecs[codec] += 1
        self.keys += message.key
        self.numbers.add(message)
        return {
            "n": self.count,
            "frame": message.frame_index,
            "kind": "key" if message.key else "inter",
            "codec": codec,
            "columns": message.width,
            "packets": message.packets,
            "bytes": size,
            "sections": " ".join(f"{name}={bytes_}" for name, bytes_ in sizes.items()),
        }


def inspect_recording(path: Path) -> dict[str, Any]:
    """Metadata, totals, and a line for each of the first messages.

    Raises SourceError if it is not a recording.
    """
    seen, recorded = _Messages(), Counter[str]()
    stamps: list[int] = []
    first: list[bytes] = []
    with open_regular(path) as handle:
        reader = RecordingReader(handle)
        metadata = without_text(reader.metadata)
        for stamp_ns, data in reader.messages():
            stamps = [stamps[0] if stamps else stamp_ns, stamp_ns]
            seen.add(data)
        refinements = reader.refinements
        counts = dict(reader.counts)
        for packet in reader.packets():
            if not seen.count:
                stamps = [stamps[0] if stamps else packet.stamp_ns, packet.stamp_ns]
            recorded["position packets" if packet.position else "packets"] += 1
            if len(first) < STREAM_PACKETS and not packet.position:
                first.append(packet.payload)
        sensor = seen.sent.sensor or _sensor_seen_in(path, first)
    positions = recorded["position packets"] + seen.positions
    came = {"refinements": refinements.came, "bytes of refinements": refinements.came_bytes}
    return {
        "recording": str(path),
        "metadata": metadata,
        **({} if sensor is None else {"sensor": sensor.name, "model": sensor.model, "rows": sensor.rows}),
        "messages": seen.count,
        **_frames(path, seen, recorded),
        **(came if refinements.came else {}),
        "raw packets": recorded["packets"],
        **({"position packets": positions} if positions else {}),
        "begins": time_text(stamps[0]) if stamps else None,
        "duration_s": round((stamps[1] - stamps[0]) * 1e-9, 3) if stamps else None,
        "codecs": dict(seen.codecs),
        **({"sent": seen.sent.result() | _measured(reader.losses)} if seen.numbers.frames else {}),
        **({"bytes of messages": seen.size} if seen.count else {}),
        "bytes by section": dict(seen.sections),
        "noticed": counts,
        **(
            {f"messages 0 to {len(seen.rows) - 1}": [row for row in seen.rows if "damaged" not in row]}
            if seen.rows
            else {}
        ),
        "damaged": [row for row in seen.rows if "damaged" in row],
    }


def _frames(path: Path, seen: _Messages, recorded: Counter[str]) -> dict[str, Any]:
    """Frames, those that are missing between them, and damaged messages; of raw packets, how they are read."""
    if recorded["packets"] and not (seen.numbers.frames or seen.damaged):
        how = (
            f'raw packets, not frames: `lidarcodec info "{path}?read=packets"` finds their frames, and '
            f"`lidarcodec convert {path} drive.pcap` writes them as a capture"
        )
        return {"frames": None, "holds": how}
    longest = seen.numbers.longest()
    hole = (
        f"{longest.seconds:.1f} s, {counted(longest.frames, 'frame')}, after {time_text(longest.from_ns)}"
        if longest
        else None
    )
    return {
        "key messages": seen.keys,
        "frames": seen.numbers.frames,
        "missing frames": seen.numbers.missing,
        **({"longest hole": hole} if hole else {}),
        "damaged messages": seen.damaged,
    }


def _measured(losses: dict[str, str]) -> dict[str, Any]:
    """What `encode` measured, as the recording notes it; empty if it does not."""
    found: dict[str, float] = {}
    for name in ("returns_percent", "largest_error_m", "intensity_rms", "left_out"):
        try:
            value = float(losses.get(name, "nan"))
        except ValueError:
            continue
        if math.isfinite(value):
            found[name] = int(value) if name == "left_out" else value
    return {"measured": found} if found else {}


def _sensor_seen_in(path: Path, payloads: list[bytes]) -> Described | None:
    """The sensor whose packets these are, by them and by the metadata beside the recording."""
    found = recognised(payloads) if payloads else None
    if found is None:
        return None
    try:
        sensor = sensor_of_packets(path, None, payloads, found.model)
    except CalibrationError:
        sensor = find_sensor(None, None, payloads, found.model)
    return Described(sensor.name, sensor.model, sensor.rows)


def explain_message(path: Path, number: int) -> dict[str, Any]:
    """Every byte of message `number`, from 0.

    Raises SettingsError if the recording has fewer, DecodeError if it is damaged beyond its header.
    """
    with open_regular(path) as handle:
        data = next(
            islice((data for _, data in RecordingReader(handle).messages()), min(number, sys.maxsize), None), None
        )
    if data is None:
        raise SettingsError(
            f"{path} has no message {number}: `lidarcodec info {path}` shows how many it has", "message"
        )
    rows = [
        {"offset": part.offset, "bytes": part.size, "what": part.name, "value": part.value} for part in explain(data)
    ]
    return {"message": number, "bytes": len(data), "from the first byte": rows}
