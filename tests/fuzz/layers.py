"""Damaged refinements: as a bad link damages them, and with checksums that are right again."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lidarcodec._native import crc32c
from lidarcodec.layers import RefinedFrame, unpack
from tests.contracts import frames
from tests.fuzz.mutations import mutated
from tests.layers.bases import Sent, sent, turn


@dataclass(frozen=True)
class _Clean:
    """A base with one of its refinements; most: range steps by which a refined range may differ from its base"""

    given: Sent
    data: bytes
    most: int


def refinement_target() -> Callable[[random.Random], tuple[bytes, Callable[[bytes], object]]]:
    """Refinements of bases of all codecs that have them, put on their bases. No range moves by more than half a step of
    the base, whatever they hold."""
    bases = [
        sent(turn(48), codec="predictive", intensity="off"),
        sent(turn(48), codec="riddle", base_error_m=1.0),
        sent(frames.three_to_one(3), codec="pcodec", intensity="levels=8", max_error_m=0.01),
    ]
    clean = [
        _Clean(given, given.refinable.code(sector), given.refinable.base_step // 2)
        for given in bases
        for sector in given.refinable.sectors[:4]
    ]

    def case(rng: random.Random) -> tuple[bytes, Callable[[bytes], object]]:
        one = rng.choice(clean)
        data = mutated(one.data, rng)
        if rng.random() < 0.7 and len(data) > 12:
            data = data[:8] + len(data).to_bytes(4, "little") + data[12:]
            data = data[:-4] + int(crc32c(data[:-4])).to_bytes(4, "little")
        return data, lambda damaged: _take(one, damaged)

    return case


def _take(one: _Clean, damaged: bytes) -> None:
    found = RefinedFrame(one.given.base, one.given.message)
    found.add(unpack(damaged))
    moved = np.abs(found.frame().range.astype(np.int64) - one.given.base.range)
    if int(moved.max(initial=0)) > one.most:
        raise AssertionError(f"a refinement moved a range by {moved.max()} steps of {one.most}")
