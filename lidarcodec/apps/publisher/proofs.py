"""Proofs: which reports of receivers count.

A report counts once for each receiver and message, and only when the receiver shows a token, the message was sent
lately, and the report repeats its checksum.

>>> proofs = Proofs()
>>> proofs.put(7, 0xC0FFEE, at_s=0.5)
>>> proofs.taken("server", 7, 0xC0FFEE, shows_token=True), proofs.taken("server", 7, 0xC0FFEE, shows_token=True)
(0.5, None)
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from typing import Final, NamedTuple

PROOFS: Final = 64
"""Number of newest messages that can be reported. They cover some seconds, because reports can be late on a slow
link."""
REFUSED: Final = ("no_token", "not_sent", "wrong_checksum", "repeated")
"""Reasons why a report does not count."""


class _Proof(NamedTuple):
    """Checksum of a message, which proves its receipt, time of put, and names of receivers that reported it."""

    at_s: float
    checksum: int
    by: set[str]


class Proofs:
    """Checks reports. Not thread-safe: `Flight` holds a lock.

    refused: number of reports that did not count, by reason
    """

    def __init__(self) -> None:
        self._proofs: OrderedDict[int, _Proof] = OrderedDict()
        self.refused: Counter[str] = Counter(dict.fromkeys(REFUSED, 0))

    def __len__(self) -> int:
        return len(self._proofs)

    def put(self, index: int, checksum: int, at_s: float) -> None:
        """A message is put."""
        self._proofs[index] = _Proof(at_s, checksum, set())
        while len(self._proofs) > PROOFS:
            self._proofs.popitem(last=False)

    def taken(self, name: str, index: int, checksum: int | None, *, shows_token: bool) -> float | None:
        """Send time of the message that a receiver reports. None if the report does not count; the refusal is
        counted.
        """
        refused = self._why_not(name, index, checksum, shows_token=shows_token)
        if refused is not None:
            self.refused[refused] += 1
            return None
        self._proofs[index].by.add(name)
        return self._proofs[index].at_s

    def _why_not(self, name: str, index: int, checksum: int | None, *, shows_token: bool) -> str | None:
        if not shows_token:
            return "no_token"
        proof = self._proofs.get(index)
        if proof is None:
            return "not_sent"
        if checksum != proof.checksum:
            return "wrong_checksum"
        return "repeated" if name in proof.by else None
