"""Mailbox: one slot between two threads. A new item replaces one that was not taken, and replaced items are counted.

>>> mailbox = Mailbox[str]()
>>> mailbox.put("old"), mailbox.put("new"), mailbox.take(0.1), mailbox.replaced
(True, True, 'new', 1)
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """A slot for one item. Closing it ends every wait; an item in it can still be taken.

    replaced: number of items that a newer one replaced
    """

    def __init__(self, on_put: Callable[[], object] | None = None) -> None:
        """on_put: called after every put and at close, for callers that do not wait in a thread; must not block."""
        self._condition = threading.Condition()
        self._item: T | None = None
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
            return self._closed and self._item is None

    def put(self, item: T) -> bool:
        """Put an item, replacing one that was not taken. False if closed: nothing is put."""
        with self._condition:
            if self._closed:
                return False
            self.replaced += self._item is not None
            self._item = item
            self._condition.notify_all()
        self._called()
        return True

    def put_wait(self, item: T, timeout_s: float) -> bool:
        """Wait for a free slot and put an item. False after the timeout or if closed: nothing is put."""
        with self._condition:
            free = self._condition.wait_for(lambda: self._item is None or self._closed, timeout_s)
            if self._closed or not free:
                return False
            self._item = item
            self._condition.notify_all()
        self._called()
        return True

    def take(self, timeout_s: float) -> T | None:
        """Wait for an item and take it. None after the timeout, or if closed and empty."""
        with self._condition:
            self._condition.wait_for(lambda: self._item is not None or self._closed, timeout_s)
            item, self._item = self._item, None
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
