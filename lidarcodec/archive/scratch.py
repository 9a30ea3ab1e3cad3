"""Inputs of a store as local files, and a folder for files in the making.

A file of a folder is used where it is. An object of a bucket is downloaded; the last inputs are kept, because the
segments of an input are worked on one after another.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from lidarcodec.archive.inputs import Input
from lidarcodec.archive.stores.base import Store, check_name

KEPT: Final = 2
"""Downloaded inputs that a process keeps."""
_here = threading.local()
"""Holds `kept`, a mapping for each thread: threads of a worker must not remove each other's files."""


def _kept_here() -> OrderedDict[tuple[str, str], Path]:
    if not hasattr(_here, "kept"):
        _here.kept = OrderedDict()
    kept: OrderedDict[tuple[str, str], Path] = _here.kept
    return kept


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """An empty folder for files of this process, removed at the end."""
    folder = Path(tempfile.mkdtemp(prefix="lidarcodec-archive-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def local(store: Store, one: Input) -> Path:
    """The path of an input, with the files that belong beside it. Raises OSError, SourceError."""
    here = store.file(one.name.rstrip("/"))
    if here is not None:
        return here
    key, kept = (store.url, one.id()), _kept_here()
    if key in kept and kept[key].exists():
        kept.move_to_end(key)
        return kept[key]
    while len(kept) >= KEPT:
        _, oldest = kept.popitem(last=False)
        shutil.rmtree(oldest.parent, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix="lidarcodec-archive-"))
    try:
        path = folder / check_name(one.name.rstrip("/")).rpartition("/")[2]
        base = one.name if one.name.endswith("/") else one.name.rpartition("/")[0]
        for entry in one.beside:
            name = entry.name.removeprefix(base).lstrip("/")
            target = (path if one.name.endswith("/") else folder) / check_name(name)
            target.parent.mkdir(parents=True, exist_ok=True)
            store.download(entry.name, target)
        if not one.name.endswith("/"):
            store.download(one.name, path)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    kept[key] = path
    return path


def forget() -> None:
    """Remove the downloaded inputs of this process."""
    kept = _kept_here()
    while kept:
        _, path = kept.popitem()
        with contextlib.suppress(OSError):
            shutil.rmtree(path.parent)
