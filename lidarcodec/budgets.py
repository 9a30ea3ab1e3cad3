"""What one input file may cost: memory, processor time, temporary disk. The one place that states it.

Every reader of files takes its limits from here, `docs/robustness.md` has the same table, and `tests/bombs` opens a
file of each kind that is made to be dear, in a process that has no more than this.

>>> BUDGETS["npz"].memory_mib
768
>>> earned = Allowance(base=2, per_byte=0.5)
>>> earned.spend(4, seen=4), earned.spend(1, seen=4)
(True, False)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from lidarcodec.files.regular import open_regular

MIB: Final = 1 << 20


@dataclass(frozen=True)
class Budget:
    """What a file of one kind may cost, whatever it holds; nothing that reads input writes to a disk.

    files:      which files these are
    size_mib:   largest file that is read; None: any, as it is read piece by piece
    memory_mib: most memory beyond that of the program
    cpu_s:      processor time until a file of up to 1 MiB is read or refused; larger ones in proportion
    """

    files: str
    size_mib: float | None
    memory_mib: int
    cpu_s: int


BUDGETS: Final[dict[str, Budget]] = {
    "capture": Budget("`.pcap`, `.pcapng`", None, 64, 10),
    "compressed": Budget("captures and scans in `.xz`, `.gz`, `.zst`", None, 320, 10),
    "mcap": Budget("recordings and bags in `.mcap`", None, 512, 20),
    "database": Budget("bags in `.db3`", None, 384, 10),
    "bag": Budget("`metadata.yaml` of a bag", 1, 128, 10),
    "scan": Budget("KITTI scans `.bin`", 16, 192, 2),
    "stamps": Budget("KITTI `timestamps*.txt`, `times.txt`", 16, 320, 10),
    "poses": Budget("poses in `.txt`, `calib.txt`", 32, 320, 10),
    "npz": Budget("poses in `.npz`", 64, 768, 5),
    "arrays": Budget("arrays of annotations, samples and caches, `.npz`, `.npy`", 2048, 4096, 20),
    "checkpoint": Budget("checkpoints of training `.pt`", 2048, 4096, 20),
    "calibration": Budget("calibrations `db.xml`, `.yaml`", 1, 128, 10),
    "weights": Budget("weights `.lcrw`", 4, 128, 2),
    "config": Budget("`publish --config` `.yaml`", 1, 128, 10),
    "zenoh": Budget("`--zenoh-config` `.json5`", 1, 128, 5),
    "certificates": Budget("`ca.pem`, `ca.key`, `deployment.json`, `users.txt`, TLS files", 1, 64, 2),
    "about": Budget("`annotation.json` and what else says what a folder holds", 1, 64, 2),
    "secret": Budget("a password in a file", 1 / 256, 16, 1),
}
"""Kind -> budget. Of networks in ONNX only those of the package are read."""

EXPANDED_BASE: Final = 256 * MIB
EXPANDED_TIMES: Final = 1000
"""Compressed data may become so many bytes, and so many times what was read of it. xz can do 7,000 times."""
RECORDS_BASE: Final = 1_000_000
RECORDS_PER_BYTE: Final = 0.25
"""Records a file may have: so many, and one for every four bytes read from the disk. Plain files never have as many."""

DECODED_BASE: Final = 60_000_000
DECODED_PER_BYTE: Final = 2000
"""Returns that the messages of a recording may decode to: so many (450 turns of an HDL-64E with nothing missing, 4 s of
`predictive`), and so many for each byte of the file. A wall in all directions, in frames that are all the same, has 350
for a byte, and in the widest frames 1,520: nothing that we write has more."""


class FileTooLargeError(ValueError):
    """A file is larger than its budget; the text completes "cannot read FILE: ..."."""


class Allowance:
    """Counts work against what was read: a small file that asks for much work is refused, a large one is not."""

    def __init__(self, base: float, per_byte: float) -> None:
        self._base, self._per_byte, self._spent = base, per_byte, 0.0

    def spend(self, amount: float, seen: int) -> bool:
        """Whether so much more is allowed. seen: bytes read from the disk until now."""
        self._spent += amount
        return self._spent <= self._base + self._per_byte * seen


def largest(kind: str) -> int | None:
    """Bytes of the largest file of a kind; None: any."""
    size = BUDGETS[kind].size_mib
    return None if size is None else int(size * MIB)


def read_file(path: Path, kind: str) -> bytes:
    """The bytes of a file, at most as many as its kind may have.

    Raises OSError (NotRegularError for a pipe or a device), FileTooLargeError.
    """
    most = largest(kind)
    with open_regular(path) as file:
        data = file.read(-1 if most is None else most + 1)
    if most is not None and len(data) > most:
        raise FileTooLargeError(f"it is larger than {most:,} bytes")
    return data
