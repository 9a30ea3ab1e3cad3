"""`python -m lidarcodec`: the command line."""

import sys

from lidarcodec.cli import main

if __name__ == "__main__":
    sys.exit(main())
