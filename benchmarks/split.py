"""Frames that nothing in the package was trained, tuned or chosen by: headline figures are measured on these.

They are the 45 single scans of KITTI, of many places. Only networks that are in no package were trained on them:
those for measuring (`weights/`), whose rows are left out, and those of RIDDLE's paper. The last third of drive 0001 is
no such split: networks and their pruning were compared on its frames 79 to 89, and settings and contexts were chosen
by the drive.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from benchmarks.scenes import DATA
from lidarcodec import api
from lidarcodec.frame import Frame

NAME: Final = "singles"
TITLE: Final = "KITTI single scans: nothing was chosen by them"
FILE: Final = "kitti_singles.pcap.xz"
CALIBRATION: Final = "kitti_hdl64e_s2_recovered_db.xml"
FRAMING: Final = "revolution"
"""Scans have 359 packets or so, and each is a whole revolution."""


def frames() -> Iterator[Frame]:
    """The scans, each of its own place.

    Raises SourceError where the capture is not in LIDARCODEC_DATA.
    """
    return api.read_frames(DATA / FILE, FRAMING, calibration=DATA / CALIBRATION)
