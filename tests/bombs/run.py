"""Opens files of `BOMBS`, each in a process with the budget of its kind: `python -m tests.bombs.run FOLDER [NAME ...]`.

A line of JSON for each: name, kind, outcome (the name of an error, `read`, or how it ended), cpu_s, memory_mib.
"""

import json
import os
import resource
import sys
from pathlib import Path

from lidarcodec.budgets import BUDGETS
from lidarcodec.errors import LidarCodecError
from lidarcodec.untrusted.npz import ArraysRefusedError
from tests.bombs.files import BOMBS

PROGRAM_MIB = 2048
"""Address space that libraries reserve beside what they use."""


def child(budget, make_path, opens, tell):
    """Open the file, tell what came of it, end."""
    resource.setrlimit(resource.RLIMIT_AS, ((PROGRAM_MIB + budget.memory_mib) << 20,) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (budget.cpu_s + 1, budget.cpu_s + 2))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # no temporary file, of any size
    try:
        opens(make_path)
        outcome = "read"
    except (LidarCodecError, ArraysRefusedError) as error:
        outcome = f"{type(error).__name__}: {error}"
    except BaseException as error:
        outcome = f"foreign {type(error).__name__}: {error}"
    os.write(tell, outcome.encode()[:2000])
    os._exit(0)


def main(folder, *names):
    for number, name in enumerate(names or BOMBS):
        kind, make, opens = BOMBS[name]
        place = folder / str(number)
        place.mkdir()
        path = make(place)
        read, write = os.pipe()
        began = resident()
        pid = os.fork()
        if pid == 0:
            child(BUDGETS[kind], path, opens, write)
        os.close(write)
        with os.fdopen(read, "rb") as pipe:
            said = pipe.read().decode(errors="replace")
        _, status, used = os.wait4(pid, 0)
        out = {
            "name": name,
            "kind": kind,
            "outcome": said or f"ended with {os.waitstatus_to_exitcode(status)}",
            "cpu_s": round(used.ru_utime + used.ru_stime, 2),
            "memory_mib": max(0, used.ru_maxrss // 1024 - began),
        }
        print(json.dumps(out), flush=True)


def resident():
    """MiB that this process has, and its child begins with."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() >> 20


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
