"""One message in a hundred, in twenty and in five is lost, by a program that subscribes and republishes."""

from __future__ import annotations

from tests.faults.between import Harm
from tests.faults.harmed import CODECS, harmed
from tests.faults.outcome import Outcome

LOSSES = (0.01, 0.05, 0.2)
OUTAGE_S = 0.3
"""Longest time without a frame when one message in twenty is lost: two frames in a row."""


def run() -> Outcome:
    rows = [harmed(f"{loss:.0%}", Harm(loss=loss), "") for loss in LOSSES]
    usual = rows[1].figures
    late = [
        f"{codec}: {usual[codec]['outage s']:g} s without a frame"
        for codec in CODECS
        if usual[codec]["outage s"] > max(OUTAGE_S, 2.0 * usual[codec]["outage s without harm"])
    ]
    return Outcome(
        "1, 5 and 20 % of messages dropped by a relay that republishes",
        rows[1].outage_s,
        "; ".join(f"{row.fault}: {row.lost}" for row in rows),
        "publisher: `timeouts` and `unreported`; receiver: `missing` and `gaps`; with h264 a key frame follows a lost "
        f"message{rows[1].reported}",
        {row.fault: row.figures for row in rows} | {"note": "at 5 %"},
        [text for row in rows for text in row.wrong] + late,
    )
