"""What a command says at its end of what came and was not kept: one line, with counts by cause."""

from __future__ import annotations

import logging
from collections import Counter
from pathlib import Path

from lidarcodec.frame import Frame
from lidarcodec.sources.unkept import unkept

log = logging.getLogger(__name__)

HOLDS_POSITIONS = ".pcap"


def say_unkept(label: str, counts: Counter[str]) -> None:
    """Warn of what a source gave, or would have given, and was not kept; nothing if all was."""
    left = unkept(counts)
    if left is not None:
        log.warning("%s: not kept: %s", label, left)


def positions_in(frame: Frame) -> int:
    """How many position packets a frame holds."""
    return 0 if frame.side is None else len(frame.side.positions)


def positions_text(out: Path, count: int) -> str:
    """What to say behind the summary of a decoded recording with so many position packets."""
    if not count:
        return ""
    kept = out.suffix.lower() == HOLDS_POSITIONS
    return f", {count} position packets" + ("" if kept else f" left out (only {HOLDS_POSITIONS} holds them)")
