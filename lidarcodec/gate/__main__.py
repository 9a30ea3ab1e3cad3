"""The process of the gate: `python -m lidarcodec.gate LISTENERS LIMITS`, started by `lidarcodec.gate.gate`.

LISTENERS is JSON: [[descriptor of a socket that listens, Zenoh's port], ...]. It ends when standard input does, and so
with the process that started it, however that ends. A line of JSON a second on standard output tells its state.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import socket
import sys
import time
from dataclasses import replace
from typing import Final

from lidarcodec.gate.keeper import Keeper
from lidarcodec.gate.limits import Limits
from lidarcodec.gate.passage import READ

TELL_S: Final = 1.0
OTHER_FILES: Final = 32


def with_handles(limits: Limits) -> Limits:
    """The limits, smaller if this process may not open that many files. A connection takes two."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
            soft = hard
    room = (soft - OTHER_FILES) // 2
    if soft == resource.RLIM_INFINITY or limits.unfinished + limits.open <= room:
        return limits
    unfinished = max(1, min(limits.unfinished, room // 2))
    return replace(limits, unfinished=unfinished, open=max(1, min(limits.open, room - unfinished)))


def main(listeners: str, limits: str) -> None:
    """Run until standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal: who started this process ends it
    given = [(socket.socket(fileno=number), port) for number, port in json.loads(listeners)]
    keeper = Keeper(given, with_handles(Limits.unpacked(limits)), time.monotonic)
    ended: list[int] = []
    keeper.selector.register(0, READ, ended.append)
    os.set_blocking(1, False)
    told_s = float("-inf")
    while not ended:
        now_s = time.monotonic()
        if now_s - told_s >= TELL_S:
            told_s = now_s
            with contextlib.suppress(OSError):  # the reader is late: the next line tells all of it
                os.write(1, json.dumps(keeper.state()).encode() + b"\n")
        keeper.run_once()
    keeper.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
