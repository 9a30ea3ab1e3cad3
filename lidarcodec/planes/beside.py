"""Two things at once: a computation in a thread of its own, beside what its caller does meanwhile.

For native code that releases the interpreter's lock, and takes much longer than a thread takes to start (0.1 ms).

>>> with beside(lambda: sum(range(10)), pays=True) as result:
...     other = max(range(10))
>>> result(), other
(45, 9)
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")


@contextmanager
def beside(compute: Callable[[], T], *, pays: bool) -> Iterator[Callable[[], T]]:
    """Compute while the block runs; the call that it is given waits for the result, or raises what `compute` raised.

    pays: whether it takes long enough for a thread. Without that, or with one processor, the call itself computes. The
    block ends when the thread has.
    """
    future: Future[T] = Future()
    thread = threading.Thread(target=_into, args=(future, compute), name="lidarcodec beside", daemon=True)
    if not (pays and processors() > 1 and _started(thread)):
        yield compute
        return
    try:
        yield future.result
    finally:
        thread.join()


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _started(thread: threading.Thread) -> bool:
    try:
        thread.start()
    except RuntimeError:  # no more threads can be started here
        return False
    return True


def _into(future: Future[T], compute: Callable[[], T]) -> None:
    try:
        future.set_result(compute())
    except BaseException as error:
        future.set_exception(error)
