"""Two things at once: a computation in a thread of its own, beside what its caller does meanwhile.

For native code that releases the interpreter's lock, and takes much longer than a thread takes to start (0.1 ms). This
is the only place below the sources that starts threads, and none outlives its call.

>>> with beside(lambda: sum(range(10)), pays=True) as result:
...     other = max(range(10))
>>> result(), other
(45, 9)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Final, TypeVar

T = TypeVar("T")

THREAD: Final = "lidarcodec beside"


@contextmanager
def beside(compute: Callable[[], T], *, pays: bool) -> Iterator[Callable[[], T]]:
    """Compute while the block runs; the call that it is given waits for the result, or raises what `compute` raised.

    pays: whether it takes long enough for a thread, and a processor is free (`has_free_processor`). Without that, or
    where no thread can be started, the call itself computes. The block ends when the thread has.
    """
    if not pays:
        yield compute
        return
    with ThreadPoolExecutor(1, THREAD) as pool:
        try:
            result: Callable[[], T] = pool.submit(compute).result
        except RuntimeError:  # no thread can be started
            result = compute
        yield result
