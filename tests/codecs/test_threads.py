"""What a user loses if these fail: a second core. Who codes two sensors, or codes while receiving, would wait."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from lidarcodec import _native, entropy
from lidarcodec.entropy.mask_coder import frame_geometry
from lidarcodec.motion.motion import STILL
from lidarcodec.motion.warp import RangeHistory, beam_rows
from tests.entropy.frames import all_fired, mask
from tests.entropy.test_predictive_coder import LEVELS, SENSOR, guess, scene

WIDTH = 2088
PATIENCE_S = 120.0


@pytest.fixture
def nobody_is_interrupted() -> Iterator[None]:
    """Python threads run until they let go of the interpreter by themselves."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(3600.0)
    yield
    sys.setswitchinterval(before)


def calls() -> dict[str, Callable[[], object]]:
    """What takes most of a frame's time, each way: the native calls alone, as numpy lets go of the interpreter, too."""
    fired, returns, ranges = all_fired(WIDTH), mask(WIDTH), scene(WIDTH)
    azimuth = np.tile(np.arange(WIDTH, dtype=np.uint16) * 17, (2, 1))
    about, cells = frame_geometry(fired, SENSOR), returns.view(np.uint8)
    coder, nothing, seen = _native.PredictiveCoder(), np.zeros((64, 0), np.uint16), guess(ranges)
    rest, in_halves = (-1, None, False, nothing, False), (-1, None, False, nothing, True)
    data = coder.encode(ranges, cells, 1, LEVELS, *about, 2000, 0, nothing, *rest)
    history = RangeHistory()
    history.remember(ranges, azimuth, fired, SENSOR)
    of_columns = (azimuth, fired.view(np.uint8), beam_rows(SENSOR))
    reader, no_mask = _native.PredictiveCoder(), np.zeros((64, 0), np.uint8)
    masked = _native.encode_mask(cells, *about, no_mask, 2000)

    def decode() -> None:
        reader.reset()
        reader.decode(data, cells, 1, LEVELS, *about, nothing, -1, nothing)

    return {
        "ranges are encoded": lambda: coder.encode(ranges, cells, 1, LEVELS, *about, 2000, 0, seen, *rest),
        "ranges are encoded in halves": lambda: coder.encode(
            ranges, cells, 1, LEVELS, *about, 2000, 0, seen, *in_halves
        ),
        "ranges are decoded": decode,
        "a mask is encoded": lambda: _native.encode_mask(cells, *about, no_mask, 2000),
        "a mask is decoded": lambda: _native.decode_mask(masked, *about, no_mask),
        "ranges are expected": lambda: history.native.expected(STILL.numbers, *of_columns),
        "a motion is searched": lambda: history.native.find_motion(ranges, *of_columns, STILL.numbers, False),
    }


@pytest.mark.usefixtures("nobody_is_interrupted")
def test_other_threads_go_on_while_one_codes() -> None:
    counted, stop = [0], threading.Event()

    def count() -> None:
        while not stop.is_set():
            counted[0] += 1
            time.sleep(0)

    work = calls()
    thread = threading.Thread(target=count)
    thread.start()
    try:
        for name, call in work.items():
            end = time.monotonic() + PATIENCE_S
            while True:
                before = counted[0]
                call()  # holds the interpreter from the line above to the line below, unless it lets go of it
                if counted[0] != before:
                    break
                assert time.monotonic() < end, f"no other thread ran while {name}"
    finally:
        stop.set()
        thread.join()


def test_two_threads_code_two_streams_as_one_after_the_other_would() -> None:
    fired, returns = all_fired(600), mask(600)

    def stream(seed: int, into: list[bytes]) -> None:
        encoder, decoder = entropy.PredictiveCoder(), entropy.PredictiveCoder()
        for frame in range(6):
            ranges = scene(600, seed + frame)
            into.append(encoder.encode(ranges, returns, fired, SENSOR, 1, LEVELS))
            came = decoder.decode(into[-1], returns, fired, SENSOR, 1, LEVELS)
            assert (came == np.where(returns, ranges, 0)).all()

    alone: list[list[bytes]] = [[], []]
    for number, into in enumerate(alone):
        stream(number * 10, into)
    together: list[list[bytes]] = [[], []]
    threads = [threading.Thread(target=stream, args=(n * 10, into)) for n, into in enumerate(together)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert together == alone
