"""Frames a second of one stream on one thread, and of two streams at once on two: what decoding without the lock of
Python's interpreter brings. By the clock on the wall, so whatever else runs on the machine counts: how long threads
waited for a core is told beside it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time
from typing import Any

from lidarcodec.frame import Frame
from lidarcodec.message import Message
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings

THREADS = (1, 2)


@contextmanager
def _all_cores() -> Iterator[int]:
    """Lets this thread, and those that it starts, run on all cores; how many there are."""
    if not hasattr(os, "sched_setaffinity"):
        yield os.cpu_count() or 1
        return
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
        yield len(os.sched_getaffinity(0))
    finally:
        os.sched_setaffinity(0, before)


def _queued() -> float:
    """Seconds that this thread was ready and waited for a core; 0 where the system does not tell."""
    try:
        return int(Path("/proc/thread-self/schedstat").read_text().split()[1]) / 1e9
    except OSError:
        return 0.0


def _decoded(messages: list[Message]) -> tuple[float, float]:
    """Seconds of processor time that decoding a stream takes, and those that it waits for a core."""
    decoder, queued, begun = StreamDecoder(), _queued(), thread_time()
    frames = sum(len(list(decoder.decode(message))) for message in messages)
    took = thread_time() - begun
    assert frames == len(messages)
    return took, _queued() - queued


def thread_scaling(given: list[Frame], settings: StreamSettings, rounds: int) -> dict[str, Any]:
    """By threads frames a second, and ms a frame of processor time and of waiting for a core, medians; the cores."""
    encoder = StreamEncoder(settings)
    messages = [message for frame in given for message in encoder.encode(frame)]
    rates: dict[int, list[float]] = {threads: [] for threads in THREADS}
    taken: dict[int, list[float]] = {threads: [] for threads in THREADS}
    queued: dict[int, list[float]] = {threads: [] for threads in THREADS}
    with _all_cores() as cores:
        _decoded(list(islice(messages, 1)))
        for _ in range(rounds):
            for threads in THREADS:
                begun = perf_counter()
                with ThreadPoolExecutor(threads) as pool:
                    seconds = list(pool.map(_decoded, [messages] * threads))
                passed = perf_counter() - begun
                count = threads * len(messages)
                rates[threads].append(count / passed)
                taken[threads].append(sum(took for took, _ in seconds) / count * 1e3)
                queued[threads].append(sum(waited for _, waited in seconds) / count * 1e3)
    return {
        "cores": cores,
        "frames_per_s": _medians(rates, 1),
        "processor_ms": _medians(taken, 2),
        "queued_ms": _medians(queued, 2),
    }


def _medians(found: dict[int, list[float]], digits: int) -> dict[str, float]:
    return {str(threads): round(median(values), digits) for threads, values in found.items()}
