"""A simulated path and the stream that adapts to it: a rate that changes, a round trip, a bucket of tokens, jitter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lidarcodec.ratecontrol.adaptive import Landing, PathState, adapted, target_kbps

FRAME_S = 0.1
ENCODE_S = 0.015
STEP_S = 0.001
LIMIT_S = 1.0


@dataclass
class Shown:
    """A frame that arrived: when, how late, its bits, the target it was made for."""

    at_s: float
    late_s: float
    bits: float
    target_kbps: float


class Path:
    """Carries `kbps(t)`; a bucket of tokens lets a burst through at once."""

    def __init__(
        self,
        kbps: Callable[[float], float],
        rtt_s: float = 0.0,
        bucket_bits: float = 0.0,
        unknown_s: Callable[[float], float] = lambda t: 0.0,
    ) -> None:
        """unknown_s: what the round trip is longer than anybody knows yet."""
        self.kbps, self.rtt_s, self.bucket_bits, self.unknown_s = kbps, rtt_s, bucket_bits, unknown_s
        self.free_s, self._tokens, self._tokens_at = 0.0, bucket_bits, 0.0

    def send(self, put_s: float, bits: float) -> float:
        """When the last bit of a message is on its way, on the publisher's side."""
        now = max(put_s, self.free_s)
        self._tokens = min(self.bucket_bits, self._tokens + 1e3 * self.kbps(now) * (now - self._tokens_at))
        at_once = min(bits, self._tokens)
        self._tokens -= at_once
        left = bits - at_once
        while left > 0.0:
            part = min(left, 1e3 * self.kbps(now) * STEP_S)
            now += STEP_S * (part / (1e3 * self.kbps(now) * STEP_S) if self.kbps(now) else 1.0)
            left -= part
        self.free_s = self._tokens_at = now
        return now


def stream(
    path: Path,
    seconds: float,
    *,
    window: int = 1,
    noise: float = 0.08,
    jitter_s: float = 0.002,
    least_bits: float = 0.0,
    most_bits: float = 1e9,
    key_every: int = 0,
    key_factor: float = 1.0,
    stale: int = 0,
    seed: int = 1,
) -> list[Shown]:
    """Frames every 0.1 s at the target, newest first, at most `window` under way; those that arrived.

    stale: the target of a frame is from so many frames before, as where it was coded while the last one was under way
    """
    rng = np.random.default_rng(seed)
    state, shown = PathState(), []
    targets: list[float] = []
    under_way: list[tuple[float, Landing]] = []  # when its report comes, what it says
    now, index, sent, last_free, last_report = 0.0, 0, 0, -1.0, 0.0
    while now < seconds:
        newest = int(now / FRAME_S)
        if newest < index:
            newest = index
            now = index * FRAME_S
        if len(under_way) >= window:
            now = max(now, under_way[0][0])
            newest = max(newest, int(now / FRAME_S))
        while under_way and under_way[0][0] <= now:
            state, _ = adapted(state, under_way.pop(0)[1])
        made_s, left_out, index = newest * FRAME_S, newest - index, newest + 1
        put = now + ENCODE_S
        key = bool(key_every) and sent % key_every == 0
        sent += 1
        targets.append(target_kbps(state))
        wanted = 1e3 * targets[max(-1 - stale, -len(targets))] * FRAME_S * (key_factor if key else 1.0)
        bits = min(max(wanted * (1.0 + noise * rng.standard_normal()), least_bits, 1e3), most_bits)
        done = path.send(put, bits)
        report = done + path.rtt_s + path.unknown_s(done) + abs(jitter_s * rng.standard_normal())
        if report - put > LIMIT_S and window == 1:
            landing = Landing(bits, LIMIT_S, LIMIT_S, path.rtt_s, key, left_out, landed=False)
            under_way.append((put + LIMIT_S, landing))
        else:
            free = report - path.rtt_s
            send_s = max(0.0, free - max(put, last_free))
            landing = Landing(bits, send_s, min(report - last_report, 1.0), path.rtt_s, key, left_out)
            under_way.append((report, landing))
        last_free, last_report = max(last_free, done), report
        shown.append(Shown(done + path.rtt_s / 2, done + path.rtt_s / 2 - made_s, bits, target_kbps(state)))
        now = put
    return shown


def late_s(shown: list[Shown], begin: float, end: float) -> float:
    """The latency that 95 % of the frames of a time do not exceed."""
    values = [one.late_s for one in shown if begin <= one.at_s < end]
    assert values
    return float(np.quantile(values, 0.95))


def sent_kbps(shown: list[Shown], begin: float, end: float) -> float:
    """Mean of what arrived in a time."""
    return sum(one.bits for one in shown if begin <= one.at_s < end) / (end - begin) / 1e3
