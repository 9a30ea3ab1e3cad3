"""The command line's first lines: `lidarcodec`, and `python -m lidarcodec`."""

import sys
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line. Whoever interrupts it before it can listen for that wants it to end, and no traceback."""
    try:
        from lidarcodec.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(0)


if __name__ == "__main__":
    main()
