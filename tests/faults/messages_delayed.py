"""A round trip of 100 ms with up to 30 ms more by chance, and one message in twenty lost."""

from __future__ import annotations

from tests.faults.between import Harm
from tests.faults.harmed import harmed
from tests.faults.outcome import Outcome

HARM = Harm(delay_s=0.05, jitter_s=0.015, loss=0.05)


def run() -> Outcome:
    fault = "a round trip of 100 to 130 ms, and 5 % of messages dropped"
    return harmed(fault, HARM, "publisher: `window` and `unreported`")
