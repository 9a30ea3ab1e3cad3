"""The command line's first lines: `lidarcodec`, and `python -m lidarcodec`."""

import os
import sys
from typing import NoReturn

from lidarcodec.commands.running.ending import DONE, INTERRUPTED, is_live


def main() -> NoReturn:
    """Run the command line. An interrupt before it can listen ends it without a traceback."""
    # Looking for plugins of pydantic through all installed packages takes a tenth of a start; we need none.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # OpenBLAS sends this process an interrupt where it gets no thread. What we compute with it is small: it needs none.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from lidarcodec.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(DONE if is_live(sys.argv[1:]) else INTERRUPTED + 2)


if __name__ == "__main__":
    main()
