"""A process that shows it is alive and prints every change it sees: what the tests of discovery start and kill.

python -m tests.transport.node NAME PORT
"""

from __future__ import annotations

import os
import sys
import threading

from lidarcodec.transport import Endpoints, open_transport


def say(word: str) -> None:
    """Write a line at once and whole: two threads write here."""
    os.write(1, f"{word}\n".encode())


def main(name: str, port: int) -> None:
    with open_transport(Endpoints(loopback_port=port)) as transport:
        transport.watch("t/*", lambda key, alive: say(("+" if alive else "-") + key[2:]))
        transport.token(f"t/{name}")
        say("ready")
        threading.Event().wait(60)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
