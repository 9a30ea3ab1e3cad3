"""One message in ten comes twice."""

from __future__ import annotations

from tests.faults.between import Harm
from tests.faults.harmed import harmed
from tests.faults.outcome import Outcome


def run() -> Outcome:
    return harmed("10 % of messages come twice", Harm(twice=0.1), "receiver: `duplicates`")
