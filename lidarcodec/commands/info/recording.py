"""`lidarcodec info FILE.mcap`: the contents of a recording, or one of its messages byte by byte."""

from __future__ import annotations

import math
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
from lidarcodec.planes.other_calibrations import Described
from lidarcodec.recording import RecordingReader
from lidarcodec.recording.holes import Numbers
from lidarcodec.sensors import find_sensor
from lidarcodec.sensors.recognise import STREAM_PACKETS, recognised
from lidarcodec.units import counted
from lidarcodec.wire import unpack

SHOWN_MESSAGES = 20


def inspect_recording(path: Path) -> dict[str, Any]:
    """Metadata, totals, and a line for each of the first messages.

    Raises SourceError if it is not a recording.
    """
    rows: list[dict[str, Any]] = []
    sections: Counter[str] = Counter()
    codecs: Counter[str] = Counter()
    messages = keys = damaged = size = coded_positions = 0
    stamps: list[int] = []
    sent, numbers = Sent(), Numbers()
    with open_regular(path) as handle:
        reader = RecordingReader(handle)
        metadata = dict(reader.metadata)
        for stamp_ns, data in reader.messages():
            messages, size = messages + 1, size + len(data)
            stamps = [stamps[0] if stamps else stamp_ns, stamp_ns]
            try:
                message = unpack(data)
            except DecodeError as error:
                damaged += 1
                row: dict[str, Any] = {"n": messages - 1, "damaged": str(error)}
            else:
                sizes: Counter[str] = Counter()
                for section in message.sections:
                    sizes[section_name(section.type)] += len(section.data)
                    coded_positions += positions_of(section)
                with suppress(DecodeError):
                    sent.add(message)
                sections += sizes
                codecs[codec_name(message.codec)] += 1
                keys += message.key
                numbers.add(message)
                row = {
                    "n": messages - 1,
                    "frame": message.frame_index,
                    "kind": "key" if message.key else "inter",
                    "codec": codec_name(message.codec),
                    "columns": message.width,
                    "packets": message.packets,
                    "bytes": len(data),
                    "sections": " ".join(f"{name}={bytes_}" for name, bytes_ in sizes.items()),
                }
            if len(rows) < SHOWN_MESSAGES:
                rows.append(row)
        refinements = reader.refinements
        counts = dict(reader.counts)
        recorded: Counter[str] = Counter()
        first: list[bytes] = []
        of_messages = bool(messages)
        for packet in reader.packets():
            if not of_messages:
                stamps = [stamps[0] if stamps else packet.stamp_ns, packet.stamp_ns]
            recorded["position packets" if packet.position else "packets"] += 1
            if len(first) < STREAM_PACKETS and not packet.position:
                first.append(packet.payload)
        sensor = sent.sensor or _sensor_seen_in(path, first)
    found = {
        "recording": str(path),
        "metadata": metadata,
        **({} if sensor is None else {"sensor": sensor.name, "model": sensor.model, "rows": sensor.rows}),
        "messages": messages,
        **_frames(path, keys, numbers, damaged, recorded),
        **(
            {"refinements": refinements.came, "bytes of refinements": refinements.came_bytes}
            if refinements.came
            else {}
        ),
        "raw packets": recorded["packets"],
        **({"position packets": positions} if (positions := recorded["position packets"] + coded_positions) else {}),
        "begins": time_text(stamps[0]) if stamps else None,
        "duration_s": round((stamps[1] - stamps[0]) * 1e-9, 3) if stamps else None,
        "codecs": dict(codecs),
        **({"sent": sent.result() | _measured(reader.losses)} if numbers.frames else {}),
        **({"bytes of messages": size} if messages else {}),
        "bytes by section": dict(sections),
        "noticed": counts,
        **({f"messages 0 to {len(rows) - 1}": [row for row in rows if "damaged" not in row]} if rows else {}),
        "damaged": [row for row in rows if "damaged" in row],
    }
    return found


def _frames(path: Path, keys: int, numbers: Numbers, damaged: int, recorded: Counter[str]) -> dict[str, Any]:
    """Frames, those that are missing between them, and damaged messages; of raw packets, how they are read."""
    if recorded["packets"] and not (numbers.frames or damaged):
        how = (
            f'raw packets, not frames: `lidarcodec info "{path}?read=packets"` finds their frames, and '
            f"`lidarcodec convert {path} drive.pcap` writes them as a capture"
        )
        return {"frames": None, "holds": how}
    longest = numbers.longest()
    hole = (
        f"{longest.seconds:.1f} s, {counted(longest.frames, 'frame')}, after {time_text(longest.from_ns)}"
        if longest
        else None
    )
    return {
        "key messages": keys,
        "frames": numbers.frames,
        "missing frames": numbers.missing,
        **({"longest hole": hole} if hole else {}),
        "damaged messages": damaged,
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
        sensor = find_sensor(path, None, payloads, found.model)
    except CalibrationError:
        sensor = find_sensor(None, None, payloads, found.model)
    return Described(sensor.name, sensor.model, sensor.rows)


def explain_message(path: Path, number: int) -> dict[str, Any]:
    """Every byte of message `number`, from 0.

    Raises SettingsError if the recording has fewer, DecodeError if it is damaged beyond its header.
    """
    with open_regular(path) as handle:
        data = next(islice((data for _, data in RecordingReader(handle).messages()), number, None), None)
    if data is None:
        raise SettingsError(
            f"{path} has no message {number}: `lidarcodec info {path}` shows how many it has", "message"
        )
    rows = [
        {"offset": part.offset, "bytes": part.size, "what": part.name, "value": part.value} for part in explain(data)
    ]
    return {"message": number, "bytes": len(data), "from the first byte": rows}
