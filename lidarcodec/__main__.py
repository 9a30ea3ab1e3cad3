"""Entry point of `lidarcodec` and `python -m lidarcodec`."""

import os
import signal
import sys
from typing import NoReturn

from lidarcodec.commands.running.ending import DONE, INTERRUPTED, is_live


def main() -> NoReturn:
    """Run the command line. Ctrl-C during the imports ends it without a traceback."""
    # Pydantic searches all installed packages for plugins. That slows the start, and we use none.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # OpenBLAS raises SIGINT in this process if it cannot start a thread. Our matrices are small: one thread is enough.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    code = DONE if is_live(sys.argv[1:]) else INTERRUPTED + signal.SIGINT
    before = signal.getsignal(signal.SIGINT)
    try:
        if before is signal.default_int_handler:
            # An exception in the middle of a library's import can come out as another one, so end here.
            signal.signal(signal.SIGINT, lambda *_: os._exit(code))
        from lidarcodec.cli import main as run

        signal.signal(signal.SIGINT, before)
        run()
    except KeyboardInterrupt:
        sys.exit(code)


if __name__ == "__main__":
    main()
