"""One message in ten comes 0.15 s later than the others, behind the next one."""

from __future__ import annotations

from tests.faults.between import Harm
from tests.faults.harmed import harmed
from tests.faults.outcome import Outcome


def run() -> Outcome:
    return harmed("10 % of messages come behind later ones", Harm(behind=0.1), "receiver: `out_of_order` and `stale`")
