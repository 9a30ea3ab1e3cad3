"""Entry point of `lidarcodec` and `python -m lidarcodec`."""

import os
import sys
from typing import NoReturn

from lidarcodec.commands.running.ending import DONE, INTERRUPTED, is_live


def main() -> NoReturn:
    """Run the command line. Ctrl-C during the imports ends it without a traceback."""
    # Pydantic searches all installed packages for plugins. That slows the start, and we use none.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # OpenBLAS raises SIGINT in this process if it cannot start a thread. Our matrices are small: one thread is enough.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from lidarcodec.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(DONE if is_live(sys.argv[1:]) else INTERRUPTED + 2)


if __name__ == "__main__":
    main()
