"""Recordings whose file is whole, and one of whose messages is damaged: as memory or a program damages it."""

from __future__ import annotations

from pathlib import Path

from lidarcodec.recording import RecordingReader
from lidarcodec.recording.mcap_file import McapFile
from lidarcodec.recording.writer import RecordingWriter


def damaged_message(source: Path, out: Path, number: int) -> Path:
    """Copy a recording, with a byte in the middle of message `number` changed."""
    with source.open("rb") as read, out.open("wb") as file:
        reader = RecordingReader(read)
        about = dict(reader.metadata)
        writer = RecordingWriter(file, about["vehicle"], about["sensor"], None, about)
        for at, (channel, stored) in enumerate(reader.everything()):
            data = bytearray(stored.data())
            if at == number:
                data[len(data) // 2] ^= 0xFF
            writer._add(channel.topic, channel.encoding, stored.log_time, bytes(data), stored.sequence)
        McapFile.close(writer)
    return out
