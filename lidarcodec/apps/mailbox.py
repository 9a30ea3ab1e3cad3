"""Mailbox: one slot between two threads. A new item replaces one that was not taken, and replaced items are counted.

An item can go on from the one before it, as a part of a turn does: it waits behind that. A new item that does not go on
replaces what waits, but not the rest of what was begun.

>>> mailbox = Mailbox[str]()
>>> mailbox.put("old"), mailbox.put("new"), mailbox.take(0.1), mailbox.replaced
(True, True, 'new', 1)
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from lidarcodec.settings import MAX_PARTS

T = TypeVar("T")


def never(item: object) -> bool:
    """No item goes on from another."""
    return False


def rest_of_begun(waiting: deque[T], goes_on: Callable[[T], bool]) -> int:
    """How many of the waiting items, from the first on, go on from one that was taken."""
    return next((at for at, item in enumerate(waiting) if not goes_on(item)), len(waiting))


class Mailbox(Generic[T]):
    """A slot for one item, and those that go on from it. Closing it ends every wait; an item in it can still be taken.

    replaced: number of items that a newer one replaced
    """

    def __init__(self, on_put: Callable[[], object] | None = None, goes_on: Callable[[T], bool] = never) -> None:
        """on_put: called after every put and at close, for callers that do not wait in a thread; must not block.
        goes_on: whether an item goes on from the one put before it."""
        self._condition = threading.Condition()
        self._items: deque[T] = deque()
        self._goes_on: Final = goes_on
        self._closed = False
        self._on_put = on_put
        self.replaced = 0

    @property
    def closed(self) -> bool:
        """Whether it was closed."""
        return self._closed

    @property
    def finished(self) -> bool:
        """Whether it is closed and empty."""
        with self._condition:
            return self._closed and not self._items

    def put(self, item: T) -> bool:
        """Put an item, replacing one that was not taken. False if closed: nothing is put."""
        with self._condition:
            if self._closed:
                return False
            if not self._goes_on(item):
                begun = rest_of_begun(self._items, self._goes_on)
                self.replaced += len(self._items) - begun
                while len(self._items) > begun:
                    self._items.pop()
            self._items.append(item)
            self._condition.notify_all()
        self._called()
        return True

    def put_wait(self, item: T, timeout_s: float) -> bool:
        """Wait for a free slot and put an item. False after the timeout or if closed: nothing is put."""
        with self._condition:
            most = MAX_PARTS if self._goes_on(item) else 1
            free = self._condition.wait_for(lambda: len(self._items) < most or self._closed, timeout_s)
            if self._closed or not free:
                return False
            self._items.append(item)
            self._condition.notify_all()
        self._called()
        return True

    def take(self, timeout_s: float) -> T | None:
        """Wait for an item and take it. None after the timeout, or if closed and empty."""
        with self._condition:
            self._condition.wait_for(lambda: bool(self._items) or self._closed, timeout_s)
            item = self._items.popleft() if self._items else None
            self._condition.notify_all()
            return item

    def close(self) -> None:
        """Accept no more items. A second call does nothing."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._called()

    def _called(self) -> None:
        if self._on_put is not None:
            self._on_put()
