"""Refinements bring any sectors of a base, in any order, to what was measured; and nothing else."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest

import lidarcodec
from lidarcodec.assembly import packets_of
from lidarcodec.codecs import table
from lidarcodec.errors import DecodeError, SectionError, SettingsError
from lidarcodec.frame import Frame
from lidarcodec.layers import SECTORS, OtherBaseError, RefinedFrame, pack, peek_refinement, unpack
from lidarcodec.layers.sectors import columns_of, nearest_ahead
from lidarcodec.pipeline import StreamEncoder, check
from lidarcodec.settings import StreamSettings, settings_from
from tests.contracts import frames
from tests.layers.bases import Sent, sent, turn
from tests.sweeps import examples

ABLE = [name for name in table.names() if table.codec(name).layered]


def refined(given: Sent, sectors: list[int] | None = None) -> RefinedFrame:
    found = RefinedFrame(given.base, given.message)
    for sector in given.refinable.sectors if sectors is None else sectors:
        assert found.add(unpack(given.refinable.code(sector)))
    return found


def payloads(frame: Frame) -> list[bytes]:
    return [packet.payload for packet in packets_of(frame)]


@pytest.mark.parametrize("codec", ABLE)
@pytest.mark.parametrize(
    "settings",
    [{}, {"intensity": "levels=8"}, {"intensity": "off"}, {"shape": "rounded", "base_error_m": 1.0}],
    ids=["plain", "levels", "off", "coarse"],
)
def test_all_sectors_in_any_order_give_the_packets(codec: str, settings: dict[str, Any]) -> None:
    given = sent(codec=codec, **settings)
    order = given.refinable.sectors
    random.Random(1).shuffle(order)
    found = refined(given, order)
    assert found.whole
    assert found.step == 1
    assert found.exact_intensity
    assert payloads(found.frame()) == payloads(given.frame)
    assert payloads(given.base) != payloads(given.frame)


@pytest.mark.parametrize(
    "frame",
    [frames.three_to_one(8), frames.noise(4), frames.one_return(), frames.irregular_side(6), frames.scene(2)],
    ids=["s3", "noise", "one return", "irregular", "slab"],
)
def test_frames_of_all_kinds_come_back(frame: Frame) -> None:
    for codec in ABLE:
        given = sent(frame, codec=codec, intensity="off")
        assert payloads(refined(given).frame()) == payloads(frame)


def test_a_lost_sector_costs_its_columns_and_nothing_else() -> None:
    given = sent()
    for lost in given.refinable.sectors:
        found = refined(given, [sector for sector in given.refinable.sectors if sector != lost])
        columns = np.isin(np.arange(given.frame.width), columns_of(given.frame.azimuth, lost))
        came = found.frame()
        assert not found.whole
        assert found.step is None
        np.testing.assert_array_equal(came.range[:, ~columns], given.frame.range[:, ~columns])
        np.testing.assert_array_equal(came.range[:, columns], given.base.range[:, columns])


def test_refinements_keep_a_bound_of_their_own() -> None:
    given = sent(max_error_m=0.01, intensity="levels=8")
    found = refined(given)
    off = np.abs(found.frame().range.astype(int) - given.frame.range.astype(int))
    assert found.step == 11
    assert not found.exact_intensity
    assert 0 < off.max() <= 5


def test_the_base_is_the_message_of_one_layer_with_its_bound() -> None:
    for codec in ABLE:
        one = StreamEncoder(StreamSettings(codec=codec, max_error_m=0.05), 7).encode(turn())
        assert one == [sent(codec=codec).message]


def test_a_refinement_of_another_base_is_refused() -> None:
    given, other = sent(), sent(base_error_m=0.06)
    found = RefinedFrame(given.base, given.message)
    one = unpack(given.refinable.code(3))
    for wrong in (
        unpack(other.refinable.code(3)),
        one._replace(stream_id=8),
        one._replace(frame_index=1),
        one._replace(base=one.base ^ 1),
    ):
        with pytest.raises(OtherBaseError, match="does not fit this base"):
            found.add(wrong)
    with pytest.raises(SectionError, match="of a base with step 51"):
        found.add(one._replace(base_step=53))
    with pytest.raises(SectionError, match="for a sector of 8"):
        found.add(one._replace(columns=9))
    assert found.frame() is given.base
    assert found.add(one)
    assert not found.add(one)


@pytest.mark.drawn
def test_cut_and_mutated_refinements_change_nothing_or_are_within_the_base() -> None:
    given, rng = sent(intensity="off"), random.Random(3)
    whole = given.refinable.code(0)
    for size in range(len(whole)):
        with pytest.raises(DecodeError):
            unpack(whole[:size])
    one = unpack(whole)
    assert one.ranges is not None
    assert one.intensity is not None
    for _ in range(examples(300)):
        ranges, intensity = bytearray(one.ranges), bytearray(one.intensity)
        for part in (ranges, intensity):
            part[rng.randrange(len(part))] ^= 1 << rng.randrange(8)
        found = RefinedFrame(given.base, given.message)
        try:
            found.add(unpack(pack(one._replace(ranges=bytes(ranges), intensity=bytes(intensity)))))
        except DecodeError:
            assert found.frame() is given.base
        else:
            assert np.abs(found.frame().range.astype(int) - given.base.range.astype(int)).max() <= 25


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"sector": SECTORS}, "sector is 12"),
        ({"step": 2}, "always odd"),
        ({"step": 51}, "step is 51"),
        ({"base_step": 20_003}, "step of the base"),
        ({"columns": 0}, "number of columns"),
        ({"ranges": None, "intensity": b"4"}, "step is 1"),
        ({"ranges": None, "step": 51}, "refines nothing"),
        ({"frame_index": 2**63}, "frame index"),
    ],
)
def test_heads_beyond_their_limits_are_refused(change: dict[str, Any], error: str) -> None:
    data = pack(unpack(sent().refinable.code(0))._replace(**change))
    with pytest.raises(DecodeError, match=error):
        peek_refinement(data)


def test_sectors_ahead_are_sent_first() -> None:
    assert nearest_ahead(turn().azimuth) == [0, 11, 1, 10, 2, 9, 3, 8, 4, 7, 5, 6]
    assert nearest_ahead(frames.scene(2).azimuth) == [0]


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({"codec": "jpeg"}, "codec jpeg does not support base_error_m: .* predictive"),
        ({"max_error_m": 0.05}, "must be larger than max_error_m"),
        ({"base_error_m": 0.001}, "must be larger than max_error_m"),
        ({"base_error_m": 0}, "must be more than 0"),
        ({"base_error_m": 30}, "must be at most 20"),
        ({"target_kbps": 900}, "leave out target_kbps"),
        ({"reduction": "voxel"}, "leave out reduction"),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(values: dict[str, Any], error: str) -> None:
    with pytest.raises(SettingsError, match=error):
        check(settings_from({"base_error_m": 0.05} | values))


def test_other_sensors_are_refused() -> None:
    with pytest.raises(SettingsError, match="works only with an HDL-64E"):
        list(lidarcodec.encode(lidarcodec.read_frames("sim:city?frames=1&sensor=vlp16"), base_error_m=0.05))


def test_the_python_interface_takes_refinements_where_it_is_asked_to() -> None:
    given = [turn(index=index) for index in range(2)]
    messages = list(lidarcodec.encode(given, codec="pcodec", base_error_m=0.05))
    assert len(messages) == 2 * (1 + SECTORS)
    both = zip(lidarcodec.decode(messages, layered=True), lidarcodec.decode(messages), given, strict=True)
    for exact, base, frame in both:
        np.testing.assert_array_equal(exact.range, frame.range)
        assert 0 < np.abs(base.range.astype(int) - frame.range.astype(int)).max() <= 25
