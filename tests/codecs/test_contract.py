"""Every codec of the table keeps the contract; a wrong one does not get away with it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest

from lidarcodec.codecs import table
from lidarcodec.codecs.base import Decoder
from lidarcodec.errors import SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message
from tests.contracts import codec as contract
from tests.sweeps import marked, sampled

VARIANTS = {
    "pcodec with mask history": contract.from_table("pcodec", mask_history=True),
    "predictive without memory": contract.from_table("predictive", memory=False),
    "predictive with motion": contract.from_table("predictive", motion=True),
    "riddle at most effort": contract.from_table("riddle", effort=4),
    "riddle without memory": contract.from_table("riddle", memory=False),
}
"""Settings of a codec that change what its messages refer to."""
VARIANTS_AT_ONCE = ("pcodec with mask history", "predictive with motion")
LAYERED = ("jpeg-layered", "h264-log")
"""Codecs that differ from another one in how they map ranges to pictures."""
MADE_ALIKE = (contract.check_intensity, contract.check_mutated, contract.check_same_bytes)
"""Checks of what variants do as the codec does of which they are."""


def cases() -> list[Any]:
    every = list(product([*table.names(), *VARIANTS], contract.CHECKS))
    swept = {*VARIANTS} - {*VARIANTS_AT_ONCE}
    alike = {*VARIANTS, *LAYERED}
    kept = [(name, check) for name, check in every if name not in swept and not (name in alike and check in MADE_ALIKE)]
    at_random = [case for case in kept if case[1] is contract.check_mutated]
    rest = [case for case in every if case not in at_random]
    return [marked(case, pytest.mark.hypothesis) for case in at_random] + sampled(rest, kept)


@pytest.mark.parametrize(
    ("name", "check"), cases(), ids=lambda value: getattr(value, "__name__", str(value)).removeprefix("check_")
)
def test_contract(name: str, check: Callable[[contract.CodecUnderTest], None]) -> None:
    codec = VARIANTS[name] if name in VARIANTS else contract.from_table(name)
    if check is contract.check_bound and not codec.bounded:
        pytest.skip(f"{name} does not offer a bound")
    check(codec)


class Spoiled:
    """A decoder that spoils what another one decodes."""

    def __init__(self, decoder: Decoder, spoil: Callable[[Frame], Frame]) -> None:
        self.decoder, self.spoil = decoder, spoil

    def decode(self, message: Message) -> list[Frame]:
        return [self.spoil(frame) for frame in self.decoder.decode(message)]

    def flush(self) -> list[Frame]:
        return []


def one_step_further(frame: Frame) -> Frame:
    """The farthest return a step further away."""
    ranges = frame.range.copy()
    if ranges.any():
        ranges.flat[ranges.argmax()] ^= 1
    return frame.with_(range=ranges)


def first_return_lost(frame: Frame) -> Frame:
    """One return is gone."""
    ranges = frame.range.copy()
    ranges.flat[np.flatnonzero(ranges)[:1]] = 0
    return frame.with_(range=ranges)


SPOILS: dict[str, tuple[Callable[[Frame], Frame], Callable[[contract.CodecUnderTest], None]]] = {
    "a range": (one_step_further, contract.check_lossless),
    "a lost return": (first_return_lost, contract.check_bound),
    "an intensity": (lambda frame: frame.with_(intensity=frame.intensity // 2), contract.check_intensity),
    "the index": (lambda frame: frame.with_(index=frame.index + 1), contract.check_lossless),
    "the packets": (lambda frame: frame.with_(side=None), contract.check_lossless),
    "the keep mask": (
        lambda frame: frame.with_(range=np.maximum(frame.range, np.uint16(1))),
        contract.check_reduced,
    ),
}


@pytest.mark.parametrize("what", SPOILS)
def test_a_codec_that_spoils_something_fails(what: str) -> None:
    spoil, check = SPOILS[what]
    right = contract.from_table("zstd")
    wrong = contract.CodecUnderTest("zstd", right.encoder, lambda: Spoiled(right.decoder(), spoil))  # type: ignore[arg-type]
    check(right)
    with pytest.raises(AssertionError):
        check(wrong)


class Fragile:
    """A decoder that lets errors of other libraries through."""

    def __init__(self, decoder: Decoder) -> None:
        self.decoder = decoder

    def decode(self, message: Message) -> list[Frame]:
        try:
            return self.decoder.decode(message)
        except SectionError as error:
            raise ValueError(str(error)) from None

    def flush(self) -> list[Frame]:
        return []


def test_a_codec_that_raises_other_errors_fails() -> None:
    right = contract.from_table("raw")
    wrong = contract.CodecUnderTest("raw", right.encoder, lambda: Fragile(right.decoder()))  # type: ignore[arg-type]
    for check in (contract.check_mutated, contract.check_random_sections, contract.check_resized):
        with pytest.raises(ValueError, match=r"[a-z]"):
            check(wrong)
