"""Limits of memory and processor time for reading one input file.

Every reader of files takes its limits from here, and `docs/robustness.md` has the same table. `tests/bombs` opens a
hostile file of each kind in a process with exactly these limits.

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
    """Limits for reading a file of one kind, whatever it holds. No reader writes to a disk.

    files:      the files, in words
    size_mib:   size of the largest file that is read; None: no limit, the file is read piece by piece
    memory_mib: largest memory on top of that of the program
    cpu_s:      processor time to read or refuse a file of up to 1 MiB; larger files in proportion
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
    "rosbag1": Budget("bags of ROS 1 in `.bag`", None, 512, 20),
    "bag": Budget("`metadata.yaml` of a bag", 1, 128, 10),
    "scan": Budget("KITTI scans `.bin`", 16, 192, 2),
    "stamps": Budget("KITTI `timestamps*.txt`, `times.txt`", 16, 320, 10),
    "poses": Budget("poses in `.txt`, `calib.txt`", 32, 320, 10),
    "npz": Budget("poses in `.npz`", 64, 768, 5),
    "arrays": Budget("arrays of annotations, samples and caches, `.npz`, `.npy`", 2048, 4096, 20),
    "checkpoint": Budget("checkpoints of training `.pt`", 2048, 4096, 20),
    "calibration": Budget("calibrations `db.xml`, `.yaml`, `.csv`, metadata `.json`", 1, 128, 10),
    "weights": Budget("weights `.lcrw`, and `.npz` for maps", 4, 128, 2),
    "map": Budget("maps `.lcmap`", None, 768, 60),
    "config": Budget("`publish --config` `.yaml`", 1, 128, 10),
    "zenoh": Budget("`--zenoh-config` `.json5`", 1, 128, 5),
    "certificates": Budget("`ca.pem`, `ca.key`, `deployment.json`, `users.txt`, TLS files", 1, 64, 2),
    "about": Budget("`annotation.json` and what else says what a folder holds", 1, 64, 2),
    "secret": Budget("a password in a file", 1 / 256, 16, 1),
}
"""Kind -> budget. Networks in ONNX have none: only those of the package are read."""

EXPANDED_BASE: Final = 256 * MIB
EXPANDED_TIMES: Final = 1000
"""Compressed data may expand to EXPANDED_BASE bytes plus EXPANDED_TIMES the bytes read. xz could reach 7,000 times."""
RECORDS_BASE: Final = 1_000_000
RECORDS_PER_BYTE: Final = 0.25
"""A file may hold RECORDS_BASE records plus one for every four bytes read. Uncompressed files always hold fewer."""

DECODED_BASE: Final = 60_000_000
DECODED_PER_BYTE: Final = 2000
"""Returns that the messages of a recording may decode to: DECODED_BASE (450 full turns of an HDL-64E) plus
DECODED_PER_BYTE for each byte of the file. The most compressible recording, identical frames of a wall all around, has
350 returns a byte, and 1,520 in the widest frames."""


class FileTooLargeError(ValueError):
    """A file is larger than its budget; the text completes "cannot read FILE: ..."."""


class Allowance:
    """Limits work in proportion to the bytes read, so that a small file cannot ask for much work."""

    def __init__(self, base: float, per_byte: float) -> None:
        self._base, self._per_byte, self._spent = base, per_byte, 0.0

    def spend(self, amount: float, seen: int) -> bool:
        """Add `amount` to the work done; whether the total is still allowed. seen: bytes read from the disk so far."""
        self._spent += amount
        return self._spent <= self._base + self._per_byte * seen


def largest(kind: str) -> int | None:
    """Bytes of the largest file of a kind that is read; None: no limit."""
    size = BUDGETS[kind].size_mib
    return None if size is None else int(size * MIB)


def read_file(path: Path, kind: str) -> bytes:
    """The bytes of a file.

    Raises OSError (NotRegularError for a pipe or a device), and FileTooLargeError for a file above its budget.
    """
    most = largest(kind)
    with open_regular(path) as file:
        data = file.read(-1 if most is None else most + 1)
    if most is not None and len(data) > most:
        raise FileTooLargeError(f"it is larger than {most:,} bytes")
    return data
