"""Notices: warnings about packets that a live source refuses: one for each cause, and one more when its count is ten
times as high.

>>> notices = Notices("UDP 0.0.0.0 port 2368", lambda text: print(text))
>>> notices.tell("stranger", 3, "refused {packets} from 192.0.2.7", now_s=0.0)
>>> notices.tell("stranger", 900, "refused {packets} from 192.0.2.7", now_s=1.5)
UDP 0.0.0.0 port 2368: refused 900 packets from 192.0.2.7
>>> notices.tell("stranger", 901, "refused {packets} from 192.0.2.7", now_s=2.5)
>>> notices.close()
UDP 0.0.0.0 port 2368: refused 901 packets from 192.0.2.7
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

SETTLE_S: Final = 1.0
"""Time from the first packet of a cause to its warning, so that the warning has a meaningful count."""
AGAIN: Final = 10
MAX_CAUSES: Final = 32


class Notices:
    """Logs what was refused and how often. Bounded: at most 32 causes, each a few times."""

    def __init__(self, label: str, say: Callable[[str], object]) -> None:
        self._label, self._say = label, say
        self._causes: dict[str, _Cause] = {}

    def tell(self, cause: str, count: int, text: str, now_s: float) -> None:
        """Report the current count of a cause. text: the warning; `{packets}` in it becomes the count."""
        if not count:
            return
        known = self._causes.get(cause)
        if known is None:
            if len(self._causes) >= MAX_CAUSES:
                return
            known = self._causes[cause] = _Cause(now_s)
        known.count, known.text = count, text
        if now_s - known.since_s >= SETTLE_S and count >= (AGAIN * known.said or 1):
            self._tell(known)

    def close(self) -> None:
        """Log the last counts that were not logged yet."""
        for cause in list(self._causes.values()):
            if cause.count > cause.said:
                self._tell(cause)

    def _tell(self, cause: _Cause) -> None:
        cause.said = cause.count
        packets = "one packet" if cause.count == 1 else f"{cause.count:,} packets"
        self._say(f"{self._label}: {cause.text.format(packets=packets)}")


class _Cause:
    def __init__(self, since_s: float) -> None:
        self.since_s = since_s
        self.count = self.said = 0
        self.text = ""
