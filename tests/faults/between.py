"""Between: a program that stands between publisher and receiver, subscribes to one and publishes to the other.

Such things exist: bridges, gateways, recorders that play on. This one harms the messages that it passes on.
"""

from __future__ import annotations

import heapq
import random
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from lidarcodec.transport import Transport
from lidarcodec.transport.base import Closeable, Priority, Sender
from lidarcodec.transport.keys import StreamKeys

ASK_S = 2.0


@dataclass(frozen=True)
class Harm:
    """What happens to messages. Parts are of 1.

    loss: part of the messages that is lost
    burst_s, every_s: for `burst_s` out of `every_s`, all are lost
    delay_s, jitter_s: time that everything takes, each way, and most that is added to it by chance; order is kept
    behind, behind_s: part of the messages that comes so much later, behind those sent after it
    twice: part of the messages that comes twice, the second time up to 0.15 s later
    """

    loss: float = 0.0
    burst_s: float = 0.0
    every_s: float = 5.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    behind: float = 0.0
    behind_s: float = 0.15
    twice: float = 0.0


class Line:
    """Calls functions later, in the order of their times."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, int, Callable[[], object]]] = []
        self._number, self._newest_s, self._closed = 0, 0.0, False
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def put(self, after_s: float, call: Callable[[], object], *, in_order: bool = True) -> None:
        """Call after that time. in_order: not before those that were put before, in order."""
        with self._condition:
            at_s = time.monotonic() + after_s
            if in_order:
                at_s = self._newest_s = max(at_s, self._newest_s)
            self._number += 1
            heapq.heappush(self._waiting, (at_s, self._number, call))
            self._condition.notify_all()

    def close(self) -> None:
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join(5)

    def _run(self) -> None:
        while True:
            with self._condition:
                while not self._closed and (not self._waiting or self._waiting[0][0] > time.monotonic()):
                    self._condition.wait(self._waiting[0][0] - time.monotonic() if self._waiting else None)
                if self._closed:
                    return
                call = heapq.heappop(self._waiting)[2]
            call()


class Between:
    """Passes on everything of a stream between two networks, except what `harm` says.

    passed, dropped, late: messages; late ones came behind others
    """

    def __init__(self, keys: StreamKeys, near: Transport, far: Transport, harm: Harm, *, seed: int = 1) -> None:
        self.passed = self.dropped = self.late = 0
        self._keys, self._harm, self._random = keys, harm, random.Random(seed)
        self._begin_s: float | None = None
        self._there, self._back = Line(), Line()
        self._near, self._far = near, far
        self._tokens: dict[str, Closeable] = {}
        self._senders: dict[str, Sender] = {}
        self._frames = self._far.sender(keys.frame, Priority.FRAMES)
        self._inbox = self._near.inbox(keys.frame)
        self._far.listen(keys.arrived(), lambda key, data: self._forward(key, data, Priority.REAL_TIME))
        self._far.listen(keys.report(), lambda key, data: self._forward(key, data, Priority.STATUS))
        status = self._far.sender(keys.status, Priority.STATUS)
        self._near.listen(keys.status, lambda key, data: status.put(data))
        for key in (keys.control_get, keys.control_set, keys.control_keyframe):
            self._far.answer(key, lambda data, key=key: self._ask(key, data))  # type: ignore[misc]
        self._far.watch(keys.arrived(), lambda key, alive: self._token(self._near, key, alive))
        self._near.watch(keys.alive, lambda key, alive: self._token(self._far, key, alive))
        self._thread = threading.Thread(target=self._pass_frames, daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """Harm messages from now on; delays are there from the start."""
        self._begin_s = time.monotonic()

    def end(self) -> None:
        """Lose, repeat and reorder no more messages."""
        self._begin_s = None

    def close(self) -> None:
        self._there.close()  # first: what is under way would be sent into a closed session
        self._back.close()
        self._near.close()
        self._far.close()
        self._thread.join(5)

    def _pass_frames(self) -> None:
        while (data := self._inbox.receive()) is not None:
            if self._loses():
                self.dropped += 1
                continue
            self.passed += 1
            late = self._begin_s is not None and self._random.random() < self._harm.behind
            self.late += late
            self._put_frame(data, self._harm.behind_s if late else 0.0, in_order=not late)
            if self._begin_s is not None and self._random.random() < self._harm.twice:
                self._put_frame(data, self._random.random() * 0.15, in_order=False)

    def _loses(self) -> bool:
        if self._begin_s is None:
            return False
        since_s = time.monotonic() - self._begin_s
        return self._random.random() < self._harm.loss or since_s % self._harm.every_s < self._harm.burst_s

    def _put_frame(self, data: bytes, more_s: float, *, in_order: bool) -> None:
        self._there.put(self._takes_s() + more_s, lambda: self._frames.put(data), in_order=in_order)

    def _takes_s(self) -> float:
        return self._harm.delay_s + self._random.random() * self._harm.jitter_s

    def _forward(self, key: str, data: bytes, priority: Priority) -> None:
        if key not in self._senders:
            self._senders[key] = self._near.sender(key, priority)
        sender = self._senders[key]
        self._back.put(self._takes_s(), lambda: sender.put(data))

    def _ask(self, key: str, data: bytes) -> bytes | None:
        time.sleep(self._takes_s())
        answer = self._near.ask(key, data, ASK_S)
        time.sleep(self._takes_s())
        return answer

    def _token(self, side: object, key: str, alive: bool) -> None:
        before = self._tokens.pop(key, None)
        if before is not None:
            before.close()
        if alive:
            self._tokens[key] = side.token(key)  # type: ignore[attr-defined]
