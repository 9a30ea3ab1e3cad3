"""One sentence about received data that was not kept, from the counts of a source or an assembler.

>>> from collections import Counter
>>> unkept(Counter({"other datagrams": 12, "wrong length": 3, "position packets": 158, "lost packets": 1}))
'12 datagrams of other senders or ports, 3 datagrams of another length'
>>> unkept(Counter({"position packets": 158})) is None
True
"""

from __future__ import annotations

import logging
from collections import Counter
from typing import Final

from lidarcodec.assembly.short_turns import ShortTurns
from lidarcodec.packet import UNKEPT_POSITIONS

logger = logging.getLogger(__name__)

OTHER_POSITIONS: Final = "position packets to another port"
"""Counter of position packets that the chosen sensor sent to another port than expected."""

CAUSES: Final[dict[str, str]] = {
    "other stream": "packets of other streams",
    "other datagrams": "datagrams of other senders or ports",
    "wrong length": "datagrams of another length",
    UNKEPT_POSITIONS: "position packets",
    OTHER_POSITIONS: "position packets to another port (?position=PORT behind the source keeps them)",
    "strangers": "packets of other senders",
    "kernel drops": "packets dropped by the kernel",
    "queue drops": "packets dropped from a full queue",
    "other traffic": "frames without UDP",
    "unknown link type": "frames of an unknown link type",
    "cut packets": "datagrams of which the capture has only a part",
    "bad packets": "datagrams with wrong headers",
    "lost fragments": "datagrams that lack fragments",
    "bad fragments": "datagrams whose fragments do not fit",
    "bad scans": "messages that are not a VelodyneScan",
    "too long": "messages of more than 32 MiB",
    "undecoded messages": "messages that could not be decoded",
    "missing references": "messages whose reference is missing",
    "not refined": "frames of two layers that are not refined whole",
    "thinned frames": "frames of which not all returns were sent",
    "frames without packets": "frames that were not made from packets",
    "packets of no interface": "packets of an interface that the capture does not describe",
    "points in one cell": "points behind a nearer one of the same firing",
    "points out of range": "points out of range",
    "bad points": "points with invalid numbers",
    "empty scans": "scans without points",
    "other topics": "messages of other topics",
}
"""Counter -> text for data that was received and not kept. Other counters are of other irregularities."""

IN_PART: Final = ("not refined", "thinned frames")
"""Counters of frames that are there, but not with all that was measured."""

OF_THE_SENSOR: Final = (
    "other stream",
    UNKEPT_POSITIONS,
    OTHER_POSITIONS,
    "wrong length",
    "cut packets",
    "bad packets",
    "lost fragments",
    "bad fragments",
    "bad scans",
    "too long",
    "undecoded messages",
    "missing references",
    "packets of no interface",
)
"""Counters that may include packets of the sensor. Datagrams of other programs are not a loss."""


def unkept(counts: Counter[str]) -> str | None:
    """Texts about data that was not kept, largest counts first; None if everything was kept."""
    found = [f"{number} {CAUSES[cause]}" for cause, number in counts.most_common() if number and cause in CAUSES]
    return ", ".join(found) or None


def apart(counts: Counter[str]) -> tuple[Counter[str], Counter[str]]:
    """The counts of what was not kept, and those of what the source itself has only in part."""
    in_part = Counter({cause: counts[cause] for cause in IN_PART})
    return counts - in_part, in_part


def say_unkept(label: str, counts: Counter[str], short: ShortTurns | None = None) -> None:
    """Warn about data of a source that was not kept, or that it could not give. No warning if there is none.

    short: turns of it that lack columns
    """
    lost, in_part = apart(counts)
    if (left := unkept(lost)) is not None:
        logger.warning("%s: not kept: %s", label, left)
    if (left := unkept(in_part)) is not None:
        logger.warning("%s: only in part: %s", label, left)
    if short is not None and (text := short.text()):
        logger.warning("%s: packets are missing in it: %s", label, text)
