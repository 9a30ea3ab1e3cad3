"""Finds a bitrate for a path from the send times of its messages. Pure: no clock, no sockets.

A message of S bits that keeps the path busy for t seconds shows a capacity of S / t, even if the stream uses only a
part of the path. So the rate can follow a path up and down, without probing. With the chosen target a frame is under
way for two thirds of a frame's time. The last third is a reserve for a larger frame or a slower path.

>>> state, target_kbps = adapted(PathState(), Landing(bits=1e6, send_s=0.1, since_s=0.1))
>>> round(capacity_kbps(state)), round(target_kbps)
(10000, 6500)
>>> for _ in range(5):  # the path is cut to 2 Mbit/s
...     bits = 100 * target_kbps
...     state, target_kbps = adapted(state, Landing(bits, bits / 2e6, since_s=max(0.1, bits / 2e6)))
>>> 1100 < target_kbps < 1500
True
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from lidarcodec.ratecontrol.sustained import (
    UNLIMITED,
    USED,
    Sustained,
    after,
    interrupted,
    rate_of_two,
    unless_far_above,
)

START_KBPS: Final = 3000.0
"""The target until the first message has arrived. Most mobile networks can carry it."""
MIN_KBPS: Final = 50.0
MAX_KBPS: Final = 1e6
SHARE: Final = 0.65
"""Used share of the capacity; a frame at 10 Hz is then under way for 65 ms. In published measurements a link has no
queue at 80 % of its capacity, but has one at 91 %. The sizes of frames differ by a tenth, and by more at a new
scene."""
MIN_SHARE: Final = 0.4
LESS_SHARE: Final = 0.92
"""Factor on the share for each message during which frames were skipped: other work, such as encoding, also takes
time."""
MORE_SHARE_PER_S: Final = 0.05
PEAK: Final = 1.3
"""A key frame of a predictive codec may be under way for so many times a frame's time."""
MAX_BURST: Final = 8.0
DOWN_S: Final = 0.1
"""Time constant of a decrease: two thirds of the change in one frame, so the rate follows a drop within a second."""
HICCUP_S: Final = 0.1
FIRST_DOWN_S: Final = 0.4
"""Time constant for the first slow message that took less than HICCUP_S. Its usual cause is a busy receiver."""
UP_S: Final = 0.4
"""Time constant of an increase: one fast message may be due to a full token bucket of the network."""
SLOW: Final = 0.8
"""Two consecutive messages below this share of the capacity mean that the path became slower, or that a token bucket is
empty. A single one is probably due to a busy receiver."""
WORSE: Final = 1.1
SETTLING: Final = 3
"""Number of first measurements of a new path that are used without smoothing if they are higher; the first one also if
it is lower."""
STUCK_S: Final = 0.15
"""If a message has not arrived after so long, the next frames are made smaller. A lost one is usually known as lost
before, by the report of the next."""
AFTER_STALL: Final = 6
FASTER: Final = 2.0
"""After a stall, `AFTER_STALL` measurements are used without smoothing if they are higher: the path may be as fast as
ever. But the capacity grows at most by the factor `FASTER` with each, for a token bucket may have filled meanwhile. The
first one never lowers it, because its message may have stood still, too."""
MIN_SEND_S: Final = 0.01
"""Messages are combined until they have kept the path busy for so long. Shorter times would measure only jitter."""
NOISE_S: Final = 0.003
NOISE_SHARE: Final = 0.125
"""Uncertainty of send times as a share of the round trip. A shorter time only gives a lower bound of the capacity."""
MAX_STEP_S: Final = 1.0


class Landing(NamedTuple):
    """Size and send time of one message.

    bits: its size; send_s: time for which it alone kept the path busy, without the round trip; since_s: time since the
    previous landing; rtt_s: the round trip; key: whether it is a key frame; replaced: frames skipped since the previous
    landing; landed: False if it was given up before it arrived; send_s is then the time until that
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
    """The state of a path.

    capacity_bps: None before the first message arrived
    settling: number of further measurements without smoothing, because the path is new or stood still
    stalled: whether it stood still
    share: used share of the capacity; burst: size of a key frame relative to other frames, inter_bits: their mean size
    slow: whether the last message was clearly slower, before_bps: the capacity before it
    began: bits and seconds of the first of several consecutive slow messages
    sustained: what the path carries for long
    bits, send_s, since_s: messages combined for the next measurement
    """

    capacity_bps: float | None = None
    settling: int = SETTLING
    stalled: bool = False
    share: float = SHARE
    burst: float = 1.0
    inter_bits: float | None = None
    slow: bool = False
    before_bps: float | None = None
    began: tuple[float, float] | None = None
    sustained: Sustained = UNLIMITED
    bits: float = 0.0
    send_s: float = 0.0
    since_s: float = 0.0


def adapted(state: PathState, landing: Landing) -> tuple[PathState, float]:
    """The state after a message, and the target in kbit/s from now on."""
    state = _with_share(_with_burst(state, landing), landing)
    if not landing.landed:
        state = _stalled(state, landing)
    else:
        sustained = state.sustained
        if not (state.stalled and state.settling == AFTER_STALL):
            sustained = after(sustained, landing.bits, landing.send_s, landing.since_s, state.capacity_bps)
        taken = replace(
            state,
            sustained=sustained,
            bits=state.bits + landing.bits,
            send_s=state.send_s + max(landing.send_s, 0.0),
            since_s=state.since_s + max(landing.since_s, 0.0),
        )
        noise_s = max(NOISE_S, NOISE_SHARE * landing.rtt_s)
        enough = taken.send_s >= max(MIN_SEND_S, noise_s) or taken.since_s >= 0.1 or taken.settling
        state = _measured(taken, noise_s) if enough and taken.bits > 0.0 else taken
        state = replace(state, sustained=unless_far_above(state.sustained, _share(state) * (state.capacity_bps or 0.0)))
    return state, target_kbps(state)


def elsewhere(state: PathState) -> PathState:
    """The state after a change of the followed receiver: the next message at once determines the capacity of its
    path.
    """
    return replace(state, settling=SETTLING, stalled=False, sustained=UNLIMITED, bits=0.0, send_s=0.0, since_s=0.0)


def target_kbps(state: PathState) -> float:
    """The target: a share of the capacity, or less if key frames are so large that they would be late. It stays below
    what the path carries for long."""
    if state.capacity_bps is None:
        return START_KBPS
    bps = min(_share(state) * state.capacity_bps, USED * state.sustained.bps)
    return min(max(bps / 1e3, MIN_KBPS), MAX_KBPS)


def while_waiting(target: float, waited_for: tuple[int, float] | None) -> float:
    """The target of the next frame in kbit/s while an earlier message is under way: the path has carried less than that
    message in the time since. So frames become small before anything is measured, and do not add to a queue.

    waited_for: bytes of the oldest message under way, and seconds since it was sent; None if there is none
    """
    if waited_for is None or waited_for[1] < STUCK_S:
        return target
    return max(min(target, SHARE * 8e-3 * waited_for[0] / waited_for[1]), MIN_KBPS)


def sustained_kbps(state: PathState) -> float | None:
    """What the path carries for long, in kbit/s; None if nothing shows a token bucket."""
    return None if math.isinf(state.sustained.known_bps) else state.sustained.known_bps / 1e3


def capacity_kbps(state: PathState) -> float | None:
    """The estimated capacity of the path; None before the first message arrived."""
    return None if state.capacity_bps is None else state.capacity_bps / 1e3


def _share(state: PathState) -> float:
    return min(state.share, PEAK / state.burst)


def _measured(state: PathState, noise_s: float) -> PathState:
    """The state after combined messages. A time that is too short to measure only gives a lower bound."""
    sure = state.send_s > noise_s
    found = min(max(state.bits / max(state.send_s, noise_s), 1e3 * MIN_KBPS), 1e3 * MAX_KBPS)
    step_s = min(max(state.since_s, 1e-3), MAX_STEP_S)
    before, slow, stalled = state.capacity_bps, False, False
    if before is None or (state.settling == SETTLING and not state.stalled):
        capacity = found
    elif state.stalled and (found >= before or state.settling == AFTER_STALL):
        capacity, stalled = min(max(found, before), FASTER * before), state.settling > 1
    elif found < before:
        slow = sure and found < SLOW * before
        if slow and (otherwise := _in_vain(state)) is not None:
            found = min(max(otherwise, found), state.before_bps or before)
        believed = state.slow or state.send_s >= HICCUP_S
        time_s = DOWN_S if believed else FIRST_DOWN_S
        capacity = before if not sure else before + (found - before) * (1.0 - math.exp(-max(step_s, 0.1) / time_s))
    else:
        capacity = found if state.settling else before + (found - before) * (1.0 - math.exp(-step_s / UP_S))
    return replace(
        state,
        capacity_bps=capacity,
        before_bps=(state.before_bps if state.slow else before) if slow else None,
        began=_began(state) if slow else None,
        settling=max(state.settling - 1, 0),
        stalled=stalled,
        slow=slow,
        bits=0.0,
        send_s=0.0,
        since_s=0.0,
    )


def _began(state: PathState) -> tuple[float, float]:
    """Bits and seconds of the message with which messages became slow; of a newer one if it gets worse."""
    if state.began is None or state.send_s > WORSE * state.began[1]:
        return state.bits, state.send_s
    return state.began


def _in_vain(state: PathState) -> float | None:
    """The capacity in bits per second, if messages became smaller but hardly faster: a longer round trip that is not
    measured yet must not reduce the target to nothing. None otherwise.
    """
    if state.began is None or state.send_s > WORSE * state.began[1]:
        return None
    return rate_of_two(state.began, (state.bits, state.send_s))


def _stalled(state: PathState, landing: Landing) -> PathState:
    """The state after a message that did not arrive: the capacity is smaller, and the next measurement counts fully."""
    most = max(landing.bits / max(landing.send_s, 1e-3), 1e3 * MIN_KBPS)
    capacity = most if state.capacity_bps is None else min(state.capacity_bps, most)
    calm = interrupted(state.sustained)
    fresh = replace(state, bits=0.0, send_s=0.0, since_s=0.0)
    return replace(fresh, capacity_bps=capacity, settling=AFTER_STALL, stalled=True, sustained=calm)


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
