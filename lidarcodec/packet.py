"""Packet: the 1206 bytes a sensor sent, and when this host received them."""

from __future__ import annotations

from typing import NamedTuple


class Packet(NamedTuple):
    """One sensor packet.

    payload: 1206 bytes as they came; stamp_ns: host time of receipt, ns since the Unix epoch.
    The device's own clock is inside the payload and is never mixed with the host's.
    """

    payload: bytes
    stamp_ns: int


class FirstPacket(Packet):
    """The first packet of another sender than the one before: no frame holds packets of both."""

    __slots__ = ()
