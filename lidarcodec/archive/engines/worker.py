"""A worker: a process that does tasks, one after another. `processes.py` starts it, with a pipe.

It ends itself when it takes more memory than it may, and when the process that started it is gone.
"""

from __future__ import annotations

import contextlib
import logging
import os
import resource
import shutil
import sys
import tempfile
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

from lidarcodec.archive.scratch import forget
from lidarcodec.archive.tasks import work

logger = logging.getLogger(__name__)

OVER: Final = 77
"""Exit code of a worker that took more memory than it may."""
STATUS: Final = Path("/proc/self/statm")
"""Its second number is the resident memory of this process, in pages."""
_LOOK_S: Final = 0.1


def serve(pipe: Connection, scratch: Path, parent: int, memory_mb: int | None) -> None:
    """Do tasks until the other end of the pipe is closed.

    scratch: folder for its files;  parent: the process that started it;  memory_mb: most resident memory, in MB
    """
    tempfile.tempdir = str(scratch)
    logging.basicConfig(level=logging.ERROR, format="lidarcodec: %(message)s")
    if memory_mb is not None and not STATUS.exists():
        logger.warning("the memory of tasks is not limited here, because there is no %s", STATUS)
        memory_mb = None
    threading.Thread(target=_watch, args=(scratch, parent, memory_mb), daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        while True:
            pipe.send(work(pipe.recv()))
    forget()
    _remove(scratch)


def _watch(scratch: Path, parent: int, memory_mb: int | None) -> None:
    """End this process when it must not go on."""
    while True:
        if os.getppid() != parent:
            _remove(scratch)
            os._exit(1)
        if memory_mb is not None:
            with contextlib.suppress(OSError):  # no more open files, for a moment
                if resident_mb() > memory_mb:
                    os._exit(OVER)
        time.sleep(_LOOK_S)


def _remove(scratch: Path) -> None:
    """Remove the files of this worker, and if it is the last one, the folder of all."""
    shutil.rmtree(scratch, ignore_errors=True)
    with contextlib.suppress(OSError):
        scratch.parent.rmdir()


def resident_mb() -> float:
    """Resident memory of this process in MB. Raises OSError where there is no STATUS."""
    return int(STATUS.read_text().split()[1]) * resource.getpagesize() / 1e6


if __name__ == "__main__":
    handle, folder, started_by, most_mb = sys.argv[1:]
    serve(Connection(int(handle)), Path(folder), int(started_by), int(most_mb) or None)
