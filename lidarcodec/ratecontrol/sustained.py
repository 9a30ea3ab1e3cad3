"""What a path carries for long, where a token bucket lets more through at once. Pure: no clock, no sockets.

Mobile networks and `tc tbf` save up unused rate in a bucket, and let that many bits pass at once. A message that fits
into the bucket makes the path look many times as fast as it is. A rate that follows single messages rises until the
bucket is empty, falls too far when messages are late, and rises again.

Messages that empty the bucket tell the rate: between the arrivals of two of them, the path carried the bits of the
second, whatever the size of the bucket. The target stays below this rate. Then the bucket stays full, and messages
arrive at once. Only a higher rate can show that the path has become faster, so after a while the limit rises.

>>> state = UNLIMITED
>>> for bits, send_s in ((2e5, 0.12), (1e5, 0.1), (1e5, 0.1)):  # some bits of the first came from the bucket
...     state = after(state, bits, send_s, since_s=0.1, capacity_bps=3e6)
>>> round(state.known_bps)
1000000
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

USED: Final = 0.85
"""Used share of the limit. The rest fills the bucket again."""
LATE_S: Final = 0.06
LATE: Final = 1.4
"""A message is late if it takes at least `LATE_S`, and `LATE` times as long as the capacity lets expect."""
BUSY: Final = 0.5
"""A message after a late one is late, too, if it kept the path busy for this share of the time since that arrived."""
RUN_S: Final = 0.15
"""Shortest time over which the rate is measured, from the first late message on."""
STOOD: Final = 4.0
"""A late message that takes more than so many times as long as the capacity lets expect tells no rate: probably packets
were lost, and sent again. The measurement begins anew with it."""
HOLD_S: Final = 2.2
"""Time for which the limit stays before it rises. Each rise that is too much makes a frame or two late: where it is
shorter, a narrow path is tried so often that more than a twentieth of the frames are late."""
RISES: Final = ((3.0, 1.6), (20.0, 3.0), (100.0, 4.0))
"""How the limit rises: the factor each second, and up to how many times the known rate. First it rises gently, until
more bits were sent than the bucket can hold. If no message was late until then, the path is as fast as the limit: that
becomes the known rate, and the limit rises as the next entry says, until that was shown again. So a path that was
restored is in full use after five and a half seconds at most, and one that was not gets little more than it carries.
"""
BUCKET_BITS: Final = 1.6e5
"""Smallest assumed size of the bucket. Messages that become late while the limit rises tell a larger one."""
BUCKET: Final = 1.3
"""The bucket may hold so many times what it is known to hold."""
LARGEST_S: Final = 1.0
"""Longest time that the path needs to fill the bucket."""
EASE: Final = 0.8
"""Factor on the limit at a first late message while the limit rises. The usual cause is a busy receiver, so the limit
rises on if the next message is in time."""
LONG_S: Final = 0.2
SHORT_HOLD_S: Final = 0.5
"""While there is no limit, a first late message that took at least `LONG_S` gives one, which stays for
`SHORT_HOLD_S`."""
PLAIN_S: Final = 0.04
PLAIN: Final = 8
"""After `PLAIN` consecutive messages that were not late, but took at least `PLAIN_S`, there is no bucket: it would have
filled, and let one pass at once."""
SMALLER: Final = 0.7
"""Two messages tell a delay and a rate if the second has at most this share of the bits of the first."""
IN_VAIN: Final = 0.5
"""If more than this share of a message's time does not depend on its size, smaller messages do not help."""
MATTERS: Final = 4.0
"""A limit that allows more than so many times what the capacity allows is forgotten."""
LONGEST_S: Final = 1.0
"""Longer times between two arrivals count as this."""


@dataclass(frozen=True)
class Sustained:
    """What is known of the sustained rate.

    bps: the limit in bits per second, infinite if there is none; known_bps: the rate that the path is known to carry
    hold_s: remaining time before the limit rises; rises: whether it does; faster: how often the path was found to be
    faster since
    more_bits: bits sent above the known rate while the limit rises; bucket_bits: what they were when messages became
    late
    plain: number of the last messages in a row that were not late, but took at least `PLAIN_S`
    late: whether the last message was late
    bits, seconds: sums of consecutive late messages, without the first
    slowest: bits of the slowest of these, and the seconds for which it kept the path busy
    """

    bps: float = math.inf
    known_bps: float = math.inf
    hold_s: float = 0.0
    rises: bool = False
    faster: int = 0
    more_bits: float = 0.0
    bucket_bits: float = BUCKET_BITS
    plain: int = 0
    late: bool = False
    bits: float = 0.0
    seconds: float = 0.0
    slowest: tuple[float, float] = (0.0, 0.0)


UNLIMITED: Final = Sustained()
"""Without a limit: nothing shows a bucket."""


def after(state: Sustained, bits: float, send_s: float, since_s: float, capacity_bps: float | None) -> Sustained:
    """The state after a message that arrived.

    bits: its size; send_s: time for which it kept the path busy; since_s: time since the arrival of the one before
    capacity_bps: the capacity that the messages before it showed; None if there were none
    """
    since_s = min(max(since_s, 1e-3), LONGEST_S)
    expected_s = math.inf if capacity_bps is None else bits / capacity_bps
    late = send_s >= max(LATE_S, LATE * expected_s) or (state.late and send_s >= max(LATE_S, BUSY * since_s))
    if not late:
        plain = state.plain + 1 if send_s >= PLAIN_S else 0
        if math.isinf(state.bps) or plain == PLAIN:
            return UNLIMITED
        return _rising(replace(interrupted(state), plain=plain), bits, since_s)
    if state.late and rate_of_two(state.slowest, (bits, send_s)) is not None:
        return UNLIMITED
    if not state.late or send_s > STOOD * expected_s:  # some bits of the first one came from the bucket
        return _first(state, bits, send_s, since_s)
    slowest = (bits, send_s) if send_s > state.slowest[1] else state.slowest
    state = replace(state, bits=state.bits + bits, seconds=state.seconds + since_s, slowest=slowest)
    return state if state.seconds < RUN_S else _held(state, state.bits / state.seconds)


def interrupted(state: Sustained) -> Sustained:
    """The state with a row of messages cut off: what the last late ones told is dropped, the limit stays."""
    return replace(state, plain=0, late=False, bits=0.0, seconds=0.0, slowest=(0.0, 0.0))


def rate_of_two(slowest: tuple[float, float], smaller: tuple[float, float]) -> float | None:
    """The rate in bits per second, if messages became smaller but hardly faster: the round trip has grown, and fewer
    bits would not help. None otherwise.

    Two messages of different size determine a delay and a rate. slowest, smaller: bits and seconds of each
    """
    fewer, quicker_s = slowest[0] - smaller[0], max(slowest[1] - smaller[1], 1e-4)
    if fewer <= 0.0 or smaller[0] > SMALLER * slowest[0]:
        return None
    delay_s = smaller[1] - quicker_s * smaller[0] / fewer
    return fewer / quicker_s if delay_s > IN_VAIN * smaller[1] else None


def unless_far_above(state: Sustained, bps: float) -> Sustained:
    """The state without its limit, if that is far above `bps`, and without effect."""
    return UNLIMITED if not state.late and USED * state.bps > MATTERS * bps else state


def _first(state: Sustained, bits: float, send_s: float, since_s: float) -> Sustained:
    fresh = replace(interrupted(state), late=True)
    if math.isinf(state.bps) and not state.late and send_s >= LONG_S:
        return replace(_held(fresh, bits / max(send_s, since_s)), hold_s=SHORT_HOLD_S)
    return replace(fresh, bps=max(EASE * state.bps, state.known_bps)) if state.rises else fresh


def _held(state: Sustained, bps: float) -> Sustained:
    learned = state.rises and not state.faster
    bucket_bits = max(state.more_bits, BUCKET_BITS) if learned else state.bucket_bits
    still = replace(state, hold_s=HOLD_S, rises=False, faster=0, more_bits=0.0)
    return replace(still, bps=bps, known_bps=bps, bucket_bits=bucket_bits)


def _rising(state: Sustained, bits: float, step_s: float) -> Sustained:
    if state.hold_s > step_s:
        return replace(state, hold_s=state.hold_s - step_s)
    known_bps, faster = state.known_bps, state.faster
    more_bits = max(state.more_bits + bits - known_bps * step_s, 0.0)
    if more_bits > BUCKET * min(state.bucket_bits, LARGEST_S * state.known_bps):
        known_bps, more_bits, faster = state.bps, 0.0, faster + 1
    per_s, highest = RISES[min(faster, len(RISES) - 1)]
    bps = max(min(state.bps * per_s**step_s, highest * known_bps), state.bps)
    return replace(state, bps=bps, known_bps=known_bps, hold_s=0.0, rises=True, more_bits=more_bits, faster=faster)
