"""Senders: warnings and counts of a live source about its senders."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Mapping
from enum import IntEnum
from ipaddress import ip_address
from typing import Final

from lidarcodec._native import SenderJudge, UdpReceiver
from lidarcodec.packet import UNKEPT_POSITIONS
from lidarcodec.sources.udp.notices import Notices

logger = logging.getLogger(__name__)

RIVAL: Final = 64
"""Score (consistent packets in 0.1 s) from which a sender looks like a sensor."""
SHOWN: Final = 3
"""Refused senders that a warning names, at most."""


class SenderVerdict(IntEnum):
    """The verdict on a packet; the numbers are those of native/src/packets/udp_senders.hpp."""

    KEEP = 0
    HOLD = 1
    REFUSE = 2


class SenderReason(IntEnum):
    """The reason of a choice; the numbers are those of native/src/packets/udp_senders.hpp."""

    NONE = 0
    FIRST = 1
    SILENT = 2
    IMPLAUSIBLE = 3


class Senders:
    """Reports the choice of the sender, and warns of refused packets. It takes some microseconds, five times a second.

    pinned: the address that `?src=` names, or empty;  any_sender: packets of all are taken
    """

    def __init__(self, label: str, pinned: str, any_sender: bool) -> None:
        self._label, self._pinned, self._any = label, pinned, any_sender
        self._notices = Notices(label, logger.warning)
        self._chosen, self._place = 0, ""

    def look(self, judge: SenderJudge, counts: Mapping[str, int]) -> None:
        """Logs the changes since the last call. counts: those of the source."""
        now_s = time.monotonic()
        places = {sender: _place(*where) for sender, where, *_ in judge.report()}
        if judge.chosen != self._chosen:
            self._changed(judge, places.get(judge.chosen, "a sender that is gone"))
        if judge.not_pinned:
            text = f"refused {{packets}} from {_place(*judge.last_not_pinned)} or others: ?src={self._pinned}"
            self._notices.tell("not pinned", judge.not_pinned, f"{text} asks for that sender only", now_s)
        if self._any:
            self._mixed(judge, now_s)
        else:
            self._strangers(judge, places, now_s)
            self._ambiguous(judge, places, now_s)
        text = "refused {packets}: the sensor sends none of this length"
        self._notices.tell("wrong length", counts.get("wrong length", 0), text, now_s)

    def refused_positions(self, count: int, stranger: str) -> None:
        """Warns of other senders to the port of position packets. stranger: the address of the first one"""
        text = f"refused {{packets}} from {stranger} or others on the port of position packets"
        self._notices.tell("positions", count, f"{text}: only those of the sensor are accepted", time.monotonic())

    def close(self) -> None:
        """Logs the last counts."""
        self._notices.close()

    def _changed(self, judge: SenderJudge, place: str) -> None:
        if not self._chosen:
            logger.info("%s: packets from %s", self._label, place)
        else:
            why = (
                f"{self._place} fell silent"
                if judge.reason == SenderReason.SILENT
                else f"packets of {self._place} do not follow each other as those of a sensor do"
            )
            logger.warning(
                "%s: now reading packets from %s, because %s. To keep to one sensor, add ?src=ADDRESS",
                self._label,
                place,
                why,
            )
        self._chosen, self._place = judge.chosen, place

    def _strangers(self, judge: SenderJudge, places: Mapping[int, str], now_s: float) -> None:
        refused = judge.refused - judge.not_pinned
        if not self._chosen:
            return
        most = sorted((-count, sender) for sender, _, _, count, _ in judge.report() if count and sender != self._chosen)
        names = " and ".join(places[sender] for _, sender in most[:SHOWN])
        more = f" and {len(most) - SHOWN} others" if len(most) > SHOWN else ""
        which = f"from {names}{more}" if names else "before this was known"
        text = f"refused {{packets}} {which}: the sensor is assumed to be {self._place}"
        self._notices.tell(
            "strangers", refused, f"{text}; to choose another, add ?src=ADDRESS; to accept all, add ?any=1", now_s
        )

    def _ambiguous(self, judge: SenderJudge, places: Mapping[int, str], now_s: float) -> None:
        scores = {sender: score for sender, *_, score in judge.report()}
        if scores.get(judge.chosen, 0) < RIVAL:
            return
        for sender, _, _, refused, score in judge.report():
            if sender == judge.chosen or score < RIVAL:
                continue
            text = (
                f"two senders look like sensors, {self._place} and {places[sender]}: the first is used, and "
                f"{{packets}} of the other were refused; choose one with ?src=ADDRESS"
            )
            self._notices.tell(f"rival {self._place} {places[sender]}", refused, text, now_s)

    def _mixed(self, judge: SenderJudge, now_s: float) -> None:
        others = sum(kept for sender, _, kept, *_ in judge.report() if sender != judge.chosen)
        text = "mixed {packets} of others into one stream, as ?any=1 asks"
        self._notices.tell("mixed", others, text, now_s)


def _place(address: bytes, port: int) -> str:
    if not address:
        return "an unknown address"
    text = str(ip_address(address))
    return f"[{text}]:{port}" if ":" in text else f"{text}:{port}"


def counts_of(receiver: UdpReceiver, wrong: int, beside: Counter[str]) -> dict[str, int]:
    """What became of packets that are not in the stream, by cause.

    wrong: packets of a wrong length that Python has seen;  beside: counts of the socket of position packets
    """
    kernel, queue, refused, position = receiver.counts()
    judge = receiver.senders()
    return {
        "kernel drops": kernel + beside["kernel drops"],
        "queue drops": queue,
        "wrong length": refused + wrong + beside["wrong length"],
        "position packets": beside["position packets"],
        UNKEPT_POSITIONS: position,
        "strangers": judge.refused + beside["strangers"],
        "sender changes": judge.changes,
    }
