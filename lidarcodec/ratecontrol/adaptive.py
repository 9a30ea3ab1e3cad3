"""The bitrate that a path carries with room to spare, from what its messages took. Pure: no clock, no sockets.

A message of S bits that keeps the path busy for t seconds says S / t, however little of the path the stream uses. So
the rate can follow a path up as well as down, and nothing has to be tried out. The target is such that a frame is under
way for two thirds of a frame's time: a third is left for a frame that comes out larger and a path that gets slower.

>>> state, target_kbps = adapted(PathState(), Landing(bits=1e6, send_s=0.1, since_s=0.1))
>>> round(capacity_kbps(state)), round(target_kbps)
(10000, 6500)
>>> for _ in range(5):  # the path is cut to 2 Mbit/s
...     bits = 100 * target_kbps
...     state, target_kbps = adapted(state, Landing(bits, send_s=bits / 2e6, since_s=0.2))
>>> 1200 < target_kbps < 1500
True
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

START_KBPS: Final = 3000.0
"""What a mobile network carries in most places: the target until the first message has arrived."""
MIN_KBPS: Final = 50.0
MAX_KBPS: Final = 1e6
SHARE: Final = 0.65
"""Of the capacity; a frame at 10 Hz is then under way for 65 ms. Measured by others, 80 % of a link is still without a
queue, 91 % is not; frames differ by a tenth, and a codec's first frame of another scene by more."""
MIN_SHARE: Final = 0.4
LESS_SHARE: Final = 0.92
"""For each message during which frames were left out: time goes into something else as well, such as encoding."""
MORE_SHARE_PER_S: Final = 0.05
PEAK: Final = 1.3
"""A key frame of a codec that predicts may be under way for so many times a frame's time."""
MAX_BURST: Final = 8.0
DOWN_S: Final = 0.1
"""Time constant of a fall: two thirds of the way in a frame, so that a cut is followed within a second."""
HICCUP_S: Final = 0.1
FIRST_DOWN_S: Final = 0.4
"""That of the first slow message that was under way for less than HICCUP_S: a busy receiver, more often than a cut."""
UP_S: Final = 0.4
"""Of a rise: one fast message may have found a bucket of tokens full."""
SLOW: Final = 0.8
CUT: Final = 0.6
"""Two messages in a row at less than this part of the capacity say that the path was cut, or that a bucket has run dry.
One alone is a receiver that had something else to do."""
CAUTION_S: Final = 20.0
GROWTH_PER_S: Final = 2.0
"""For so long after a cut the capacity is believed to grow by no more than that: five times as much takes 2.3 s. A
bucket of tokens that lets any burst through and then stands would else be filled and hit again and again."""
SMALLER: Final = 0.7
WORSE: Final = 1.1
IN_VAIN: Final = 0.5
"""A message of which half of the time has nothing to do with its size is not made quicker by making it smaller."""
SETTLING: Final = 3
"""Measurements of a new path that are taken as they are, on the way up; the first one on the way down as well. A path
that stood still is new: the message that was under way at its end took long, the next ones are as fast as ever."""
MIN_SEND_S: Final = 0.01
"""Messages are taken together until they have kept the path busy for so long: below it jitter is what is measured."""
NOISE_S: Final = 0.003
NOISE_SHARE: Final = 0.125
"""Of the round trip: no time to send is known better. A shorter one only says that the capacity is at least that."""
MAX_STEP_S: Final = 1.0


class Landing(NamedTuple):
    """What one message took.

    bits: its size; send_s: time for which it alone kept the path busy, without the round trip; since_s: time since the
    landing before; rtt_s: the round trip; key: a key frame; replaced: frames left out since the landing before
    landed: False for a message that had not arrived when it was given up; send_s is then how long it was under way
    """

    bits: float
    send_s: float
    since_s: float
    rtt_s: float = 0.0
    key: bool = False
    replaced: int = 0
    landed: bool = True


@dataclass(frozen=True)
class PathState:
    """All that is known of a path.

    capacity_bps: None before the first message arrived
    settling: measurements that are still believed whole, because the path is new or stood still
    share: of the capacity that is used; burst: size of a key frame over that of the others, inter_bits: mean of those
    slow: whether the last message was clearly slower, before_bps: the capacity before it
    began: bits and seconds of the first of several slow messages in a row; caution_s: how long growth is still limited
    bits, send_s, since_s: messages taken together for the next measurement
    """

    capacity_bps: float | None = None
    settling: int = SETTLING
    share: float = SHARE
    burst: float = 1.0
    inter_bits: float | None = None
    slow: bool = False
    before_bps: float | None = None
    began: tuple[float, float] | None = None
    caution_s: float = 0.0
    bits: float = 0.0
    send_s: float = 0.0
    since_s: float = 0.0


def adapted(state: PathState, landing: Landing) -> tuple[PathState, float]:
    """The state after a message, and the target in kbit/s from now on."""
    state = _with_share(_with_burst(state, landing), landing)
    if not landing.landed:
        state = _stalled(state, landing)
    else:
        taken = replace(
            state,
            bits=state.bits + landing.bits,
            send_s=state.send_s + max(landing.send_s, 0.0),
            since_s=state.since_s + max(landing.since_s, 0.0),
        )
        noise_s = max(NOISE_S, NOISE_SHARE * landing.rtt_s)
        enough = taken.send_s >= max(MIN_SEND_S, noise_s) or taken.since_s >= 0.1 or taken.settling
        state = _measured(taken, noise_s) if enough and taken.bits > 0.0 else taken
    return state, target_kbps(state)


def elsewhere(state: PathState) -> PathState:
    """The state when another receiver is followed: the next message says at once what its path carries."""
    return replace(state, settling=SETTLING, caution_s=0.0, bits=0.0, send_s=0.0, since_s=0.0)


def target_kbps(state: PathState) -> float:
    """What to send: a share of the capacity, less when key frames are so large that they alone would lag."""
    if state.capacity_bps is None:
        return START_KBPS
    share = min(state.share, PEAK / state.burst)
    return min(max(share * state.capacity_bps / 1e3, MIN_KBPS), MAX_KBPS)


def capacity_kbps(state: PathState) -> float | None:
    """What the path was found to carry; None before the first message arrived."""
    return None if state.capacity_bps is None else state.capacity_bps / 1e3


def _measured(state: PathState, noise_s: float) -> PathState:
    """The state after messages that were taken together; a time too short to be known only says `at least`."""
    sure = state.send_s > noise_s
    found = min(max(state.bits / max(state.send_s, noise_s), 1e3 * MIN_KBPS), 1e3 * MAX_KBPS)
    step_s = min(max(state.since_s, 1e-3), MAX_STEP_S)
    caution_s = max(state.caution_s - step_s, 0.0)
    before, slow = state.capacity_bps, False
    if before is None or state.settling == SETTLING:
        capacity = found
    elif found < before:
        slow = sure and found < SLOW * before
        if slow and (otherwise := _in_vain(state)) is not None:
            found = min(max(otherwise, found), state.before_bps or before)
        believed = state.slow or state.send_s >= HICCUP_S
        time_s = DOWN_S if believed else FIRST_DOWN_S
        capacity = before if not sure else before + (found - before) * (1.0 - math.exp(-max(step_s, 0.1) / time_s))
        if slow and state.slow and found < CUT * (state.before_bps or before):
            caution_s = CAUTION_S
    else:
        capacity = found if state.settling else before + (found - before) * (1.0 - math.exp(-step_s / UP_S))
        if caution_s > 0.0 and not state.settling:
            capacity = min(capacity, before * GROWTH_PER_S**step_s)
    return replace(
        state,
        capacity_bps=capacity,
        before_bps=(state.before_bps if state.slow else before) if slow else None,
        began=_began(state) if slow else None,
        settling=max(state.settling - 1, 0),
        slow=slow,
        caution_s=caution_s,
        bits=0.0,
        send_s=0.0,
        since_s=0.0,
    )


def _began(state: PathState) -> tuple[float, float]:
    """Bits and seconds with which the messages became slow; anew when it gets worse."""
    if state.began is None or state.send_s > WORSE * state.began[1]:
        return state.bits, state.send_s
    return state.began


def _in_vain(state: PathState) -> float | None:
    """Bits per second, when messages became smaller and hardly quicker: it is not their bits that take the time, and
    fewer would not help. So a round trip that grew, before it is known, does not take the target down to nothing.

    A delay and a capacity follow from two messages of different size; None when the delay is not the larger part.
    """
    if state.began is None or state.bits > SMALLER * state.began[0] or state.send_s > WORSE * state.began[1]:
        return None
    fewer, quicker_s = state.began[0] - state.bits, max(state.began[1] - state.send_s, 1e-4)
    delay_s = state.send_s - quicker_s * state.bits / fewer
    return fewer / quicker_s if delay_s > IN_VAIN * state.send_s else None


def _stalled(state: PathState, landing: Landing) -> PathState:
    """The state after a message that did not arrive: the path carries less; what it does next is believed at once."""
    most = max(landing.bits / max(landing.send_s, 1e-3), 1e3 * MIN_KBPS)
    capacity = most if state.capacity_bps is None else min(state.capacity_bps, most)
    return replace(
        state, capacity_bps=capacity, settling=SETTLING, caution_s=CAUTION_S, bits=0.0, send_s=0.0, since_s=0.0
    )


def _with_share(state: PathState, landing: Landing) -> PathState:
    if landing.replaced > 0:
        return replace(state, share=max(MIN_SHARE, LESS_SHARE * state.share))
    more = MORE_SHARE_PER_S * min(max(landing.since_s, 0.0), MAX_STEP_S)
    return replace(state, share=min(SHARE, state.share + more))


def _with_burst(state: PathState, landing: Landing) -> PathState:
    if not landing.key:
        before = landing.bits if state.inter_bits is None else state.inter_bits
        return replace(state, inter_bits=before + 0.2 * (landing.bits - before))
    if not state.inter_bits:
        return state
    ratio = min(max(landing.bits / state.inter_bits, 1.0), MAX_BURST)
    return replace(state, burst=state.burst + 0.5 * (ratio - state.burst))
