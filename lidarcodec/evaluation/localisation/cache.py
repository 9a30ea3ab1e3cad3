"""Results in a folder, named by a digest of everything that they depend on. A second run computes only new results.

>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     kept = Cache(Path(folder))
...     first = kept.arrays(digest("a", 1), lambda: {"x": np.arange(3.0)})
...     again = kept.arrays(digest("a", 1), lambda: {"x": np.zeros(3)})
>>> again["x"]
array([0., 1., 2.])
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from lidarcodec.budgets import largest
from lidarcodec.files.whole import written_whole
from lidarcodec.untrusted.npz import ArraysRefusedError, read_npz

FORM: Final = 1
"""Version of the results; increase it when the same input gives other results than before."""
Arrays = dict[str, npt.NDArray[Any]]


def digest(*parts: Any) -> str:
    """Hexadecimal digest of arrays and plain values, in order."""
    found = hashlib.sha256(f"localisation {FORM}".encode())
    for part in parts:
        if isinstance(part, np.ndarray):
            found.update(f"{part.dtype}{part.shape}".encode())
            found.update(np.ascontiguousarray(part).tobytes())
        else:
            found.update(json.dumps(part, sort_keys=True).encode())
    return found.hexdigest()[:32]


class Cache:
    """A folder of .npz files; None stores nothing. A file that cannot be read is made again."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def arrays(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """The arrays stored under a name; otherwise call `make` and store its arrays."""
        if self.folder is None:
            return make()
        path = self.folder / f"{name}.npz"
        try:
            return read_npz(path, most_bytes=largest("arrays") or 0)
        except (OSError, ArraysRefusedError):
            made = make()
        with written_whole(path) as beside:
            np.savez(beside, **made)  # type: ignore[arg-type]
        return made
