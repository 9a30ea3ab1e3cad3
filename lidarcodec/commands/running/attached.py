"""The command line as part of another process: it ends when that one does, however that one ends.

    python -m lidarcodec.commands.running.attached publish sim:city --vehicle demo

The program that starts it holds the other end of its standard input, a pipe, and writes nothing. The system closes that
end with the process, also when `kill -9` left it no time to end anything.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from typing import Final

END_S: Final = 10.0
"""How long the end may take before it is forced."""


def end_with(pipe: int) -> None:
    """Have this process end, as a signal would end it, when the other end of a pipe is closed. pipe: its descriptor"""
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
