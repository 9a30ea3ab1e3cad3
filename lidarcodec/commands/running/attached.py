"""The command line as a child of another process: it ends with its parent, however the parent ends.

    python -m lidarcodec.commands.running.attached publish sim:city --vehicle demo

Its standard input is a pipe. The parent holds the other end and writes nothing. When the parent ends, even by
`kill -9`, the system closes that end.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from typing import Final

END_S: Final = 10.0
"""Time to end before it is forced."""


def end_with(pipe: int) -> None:
    """End this process, as a signal would, when the other end of a pipe is closed. pipe: descriptor of this end"""
    threading.Thread(target=_watch, args=(pipe,), name="lidarcodec attached", daemon=True).start()


def _watch(pipe: int) -> None:
    while os.read(pipe, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(END_S)
    os._exit(1)


def main() -> None:
    """The process."""
    end_with(0)
    from lidarcodec.__main__ import main as run

    run()


if __name__ == "__main__":
    main()
