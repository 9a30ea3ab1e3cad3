"""Nothing is skipped in silence: whatever a source counts is said at the end, or is named as no loss."""

from __future__ import annotations

import ast
from pathlib import Path

from lidarcodec.sources.unkept import CAUSES, OF_THE_SENSOR

ROOT = Path(__file__).resolve().parents[2] / "lidarcodec"
NOTICED = {
    "truncated",
    "damaged",
    "cut",
    "bytes lost",
    "mixed streams",
    "packets",
    "position packets",
    "frames",
    "irregular blocks",
    "odd packets",
    "lost packets",
    "late packets",
    "repeated packets",
    "time jumps",
    "impossible time stamp",
    "no clouds",
    "without time stamp",
}
"""Counts of what was kept, and of what was noticed or lost before it came here, which is said elsewhere."""


def counted(folder: str) -> set[str]:
    """Names that modules of a folder count."""
    found = set()
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
                name = node.value.attr if isinstance(node.value, ast.Attribute) else getattr(node.value, "id", "")
                if name in ("counts", "_counts") and isinstance(node.slice.value, str):
                    found.add(node.slice.value)
    return found


def test_every_count_of_a_source_is_a_cause_or_no_loss():
    """Points of KITTI folders and packets without an interface were left out without a word."""
    names = counted("sources") | counted("assembly")
    assert len(names) > 15
    assert names <= set(CAUSES) | NOTICED
    assert set(OF_THE_SENSOR) <= set(CAUSES)
    assert not NOTICED & set(CAUSES)
