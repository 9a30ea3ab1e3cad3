"""The command line's first lines: `lidarcodec`, and `python -m lidarcodec`."""

import sys
from typing import NoReturn

from lidarcodec.commands.ending import DONE, INTERRUPTED, is_live


def main() -> NoReturn:
    """Run the command line. An interrupt before it can listen ends it without a traceback."""
    try:
        from lidarcodec.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(DONE if is_live(sys.argv[1:]) else INTERRUPTED + 2)


if __name__ == "__main__":
    main()
