"""What commands say about data that they did not write: of recordings, and position packets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lidarcodec.entropy import decode_positions
from lidarcodec.errors import DecodeError, SourceError
from lidarcodec.frame import Frame
from lidarcodec.message import Section, SectionType
from lidarcodec.sensors.models.table import aside_name
from lidarcodec.units import MAX_PACKETS, counted

HOLDS_POSITIONS = ".pcap"


def check_recorded(recordings: dict[str, dict[str, Any] | None]) -> None:
    """Check live recordings for missing data. recordings: their last state (`BackgroundRecorder.state`) by stream, None
    for a stream that was not recorded

    Raises SourceError if one stopped before its stream, the disk was too slow, or files of it were lost.
    """
    lacking = []
    for stream, state in recordings.items():
        if state is None:
            continue
        if late := state["counts"].get("dropped", 0) + state["counts"].get("unwritten", 0):
            lacking.append(f"{stream}: the disk was too slow for {late} messages or batches of packets")
        if state["stopped"]:
            lacking.append(f"{stream}: {state['stopped']}")
        if lost := state["counts"].get("lost files", 0):
            lacking.append(f"{stream}: {lost} of its files were removed, replaced or overwritten during the recording")
    if lacking:
        raise SourceError(f"not all of the stream was recorded: {'; '.join(lacking)}")


def positions_in(frame: Frame) -> int:
    """Number of position packets in a frame."""
    return 0 if frame.side is None else len(frame.side.positions)


def positions_of(section: Section) -> int:
    """Number of position packets in a section of a message."""
    try:
        return len(decode_positions(section.data, MAX_PACKETS)) if section.type == SectionType.POSITION else 0
    except DecodeError:
        return 0


def positions_text(out: Path, count: int, model: str) -> str:
    """End of the summary of frames with `count` position packets of a sensor of that model, or those of its IMU."""
    if not count:
        return ""
    left = "" if out.suffix.lower() == HOLDS_POSITIONS else f" left out ({HOLDS_POSITIONS} and recordings hold them)"
    return f", {counted(count, aside_name(model))}{left}"
