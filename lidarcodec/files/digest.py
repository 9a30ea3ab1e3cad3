"""SHA-256 of a file, read part by part."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final

from lidarcodec.files.regular import open_regular

_PART_BYTES: Final = 1 << 20


def sha256_of(path: Path) -> str:
    """The digest in hexadecimal digits.

    Raises OSError, NotRegularError for a pipe, a device, a socket or a folder.
    """
    digest = hashlib.sha256()
    with open_regular(path) as file:
        while part := file.read(_PART_BYTES):
            digest.update(part)
    return digest.hexdigest()
