"""Names of captures, by which files beside them are found.

>>> stem_of(Path("drive.pcap.xz"))
'drive'
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

COMPRESSIONS: Final = frozenset({".xz", ".zst", ".gz", ".bz2", ".lz4"})


def stem_of(capture: Path) -> str:
    """The name of a capture without its endings, or of a folder."""
    if _is_folder(capture):
        return capture.name
    return (capture.with_suffix("") if capture.suffix.lower() in COMPRESSIONS else capture).stem


def is_file(path: Path) -> bool:
    """Whether there is such a file. A name that is too long is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # as `is_file`
        return False
