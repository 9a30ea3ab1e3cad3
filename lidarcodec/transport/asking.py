"""Questions that are asked until there is an answer, over a network that may fail at any time, and refusals.

>>> reason_of({"error": "no such map\\x1b[2J"})
'no such map [2J'
>>> retry_of({"error": "too often", "retry_s": 0.5}), retry_of({"error": "no"})
(0.5, None)
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from typing import Any, Final

from lidarcodec.errors import TransportError
from lidarcodec.transport.base import Transport

logger = logging.getLogger(__name__)

ANSWER_S: Final = 4.0
FIRST_WAIT_S, LONGEST_WAIT_S = 0.2, 5.0
_LEAST_WAIT_S: Final = 0.05
_MOST_LETTERS: Final = 200


def until_answered(
    transport: Callable[[], Transport],
    key: str,
    question: dict[str, Any],
    check: Callable[[], None],
    silent: Callable[[], None],
    pause: Callable[[float], None],
) -> tuple[bytes, float]:
    """The answer, and how long it took in s.

    transport: gives the network session, or raises TransportError while there is none
    check:     called before each question, and raises what ends the asking
    silent:    called when there was no answer
    pause:     waits so many seconds before the next question, and may raise as `check` does
    """
    data, wait_s = json.dumps(question).encode(), FIRST_WAIT_S
    while True:
        check()
        asked_s = time.monotonic()
        try:
            answer = transport().ask(key, data, ANSWER_S, beside=True)
        except TransportError as error:
            logger.debug("%s", error)
            answer = None
        if answer is not None:
            return answer, time.monotonic() - asked_s
        silent()
        pause(wait_s)
        wait_s = min(2 * wait_s, LONGEST_WAIT_S)


def retry_of(told: dict[str, Any]) -> float | None:
    """After how many seconds a question that is refused may be asked again; None for never."""
    retry_s = told.get("retry_s")
    if not isinstance(retry_s, int | float) or isinstance(retry_s, bool):
        return None
    return float(min(max(retry_s, _LEAST_WAIT_S), LONGEST_WAIT_S))


def reason_of(told: dict[str, Any]) -> str:
    """Why the other side refuses, without characters that change a terminal."""
    text = str(told.get("error", "no reason"))[:_MOST_LETTERS]
    return "".join(letter if letter.isprintable() else " " for letter in text)
