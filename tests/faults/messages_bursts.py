"""All messages of a second are lost, every five seconds."""

from __future__ import annotations

from tests.faults.between import Harm
from tests.faults.harmed import harmed
from tests.faults.outcome import Outcome


def run() -> Outcome:
    return harmed("all messages of a second dropped, every five seconds", Harm(burst_s=1.0), "publisher: `unreported`")
