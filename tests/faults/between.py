"""Between: a program that stands between publisher and receiver, subscribes to one and publishes to the other.

Such things exist: bridges, gateways, recorders that play on. This one loses every so-manieth message.
"""

from __future__ import annotations

import random
import threading

from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Closeable, Priority, Sender
from lidarcodec.transport.keys import StreamKeys

ASK_S = 2.0


class Between:
    """Passes on everything of a stream between two networks, except a part of its messages.

    passed, dropped: messages
    """

    def __init__(self, keys: StreamKeys, near: Endpoints, far: Endpoints, *, loss: float, seed: int = 1) -> None:
        self.passed = self.dropped = 0
        self._keys, self._loss, self._random = keys, loss, random.Random(seed)
        self._near, self._far = open_transport(near), open_transport(far)
        self._tokens: dict[str, Closeable] = {}
        self._senders: dict[str, Sender] = {}
        self._frames = self._far.sender(keys.frame, Priority.FRAMES)
        self._inbox = self._near.inbox(keys.frame)
        self._far.listen(keys.arrived(), lambda key, data: self._forward(key, data, Priority.REAL_TIME))
        self._far.listen(keys.report(), lambda key, data: self._forward(key, data, Priority.STATUS))
        status = self._far.sender(keys.status, Priority.STATUS)
        self._near.listen(keys.status, lambda key, data: status.put(data))
        for key in (keys.control_get, keys.control_set, keys.control_keyframe):
            self._far.answer(key, lambda data, key=key: self._near.ask(key, data, ASK_S))  # type: ignore[misc]
        self._far.watch(keys.arrived(), lambda key, alive: self._token(self._near, key, alive))
        self._near.watch(keys.alive, lambda key, alive: self._token(self._far, key, alive))
        self._thread = threading.Thread(target=self._pass_frames, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._near.close()
        self._far.close()
        self._thread.join(5)

    def _pass_frames(self) -> None:
        while (data := self._inbox.receive()) is not None:
            if self._random.random() < self._loss:
                self.dropped += 1
            else:
                self.passed += 1
                self._frames.put(data)

    def _forward(self, key: str, data: bytes, priority: Priority) -> None:
        if key not in self._senders:
            self._senders[key] = self._near.sender(key, priority)
        self._senders[key].put(data)

    def _token(self, side: object, key: str, alive: bool) -> None:
        before = self._tokens.pop(key, None)
        if before is not None:
            before.close()
        if alive:
            self._tokens[key] = side.token(key)  # type: ignore[attr-defined]
