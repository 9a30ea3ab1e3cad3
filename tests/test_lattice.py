"""A thinned frame comes back in its own columns, and what is made up between them is near the surface, marked, and
never sent on."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidarcodec import api
from lidarcodec.assembly import packets_of
from lidarcodec.codecs import table
from lidarcodec.errors import DecodeError, LidarCodecError, SectionError
from lidarcodec.filling import JUMP_M, JUMP_SHARE, between, beyond, filled, measured_only
from lidarcodec.frame import Frame
from lidarcodec.lattice import Lattice, columns_of, expanded, lattice_of, on_lattice, phase_of, thinned
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.planes.lattice_section import lattice_bytes, read_lattice
from lidarcodec.settings import StreamSettings
from lidarcodec.side import Position
from lidarcodec.units import RANGE_STEP_M
from lidarcodec.wire import pack, unpack
from tests.contracts import frames as made
from tests.positions import position
from tests.sweeps import examples

JUMP = round(JUMP_M / RANGE_STEP_M)
FRAMES = {
    "scene": made.scene(4),
    "three to one": made.three_to_one(4),
    "irregular": made.irregular_side(4),
    "one return": made.one_return(4),
    "nothing": made.scene(4, holes=1.0),
}


@pytest.mark.parametrize("codec", table.names())
@pytest.mark.parametrize("name", FRAMES)
@pytest.mark.parametrize("step", [2, 5, 64])
def test_what_is_sent_comes_back_where_it_was(codec: str, name: str, step: int) -> None:
    frame = FRAMES[name]
    encoder, decoder = StreamEncoder(StreamSettings(codec=codec, reduction=f"lattice:{step}")), StreamDecoder()
    messages = encoder.encode(frame) + encoder.flush()
    (back,) = [one for message in messages for one in decoder.decode(unpack(pack(message)))]
    sent = encoder.reduced
    assert sent is not None
    assert back.width == frame.width
    assert np.array_equal(back.lattice, sent.lattice)
    assert np.array_equal(back.range > 0, sent.valid)
    assert np.array_equal(back.fired, frame.fired)
    assert np.array_equal(back.azimuth[:, back.lattice], frame.azimuth[:, back.lattice])
    if table.codec(codec).bounded:
        assert np.array_equal(back.range, np.where(sent.valid, frame.range, 0))
        assert np.array_equal(back.intensity, np.where(sent.valid, frame.intensity, 0))
    assert len(packets_of(back)) == len(packets_of(frame)), "its packets can be rebuilt, without what was left out"


def test_position_packets_are_not_lost_with_the_columns() -> None:
    encoder, decoder = StreamEncoder(StreamSettings(reduction="lattice:4")), StreamDecoder()
    frame = FRAMES["scene"]
    positions = (Position(1, 5_000, position(5).payload),)
    (message,) = encoder.encode(frame.with_(side=replace(frame.side, positions=positions)))
    (back,) = decoder.decode(unpack(pack(message)))
    assert back.side.positions == positions


@given(st.integers(0, 3000), st.integers(1, 64), st.integers(0, 1000))
def test_the_ends_are_always_sent_and_no_gap_is_wider_than_the_step(width: int, step: int, index: int) -> None:
    columns = columns_of(width, step, phase_of(index, step))
    assert (len(columns) == 0) is (width == 0)
    if width:
        assert (columns[0], columns[-1]) == (0, width - 1)
        assert int(np.diff(columns).max(initial=1)) <= step
    assert np.array_equal(read_lattice(lattice_bytes(Lattice(width, columns))).columns, columns)


def test_every_column_is_seen_after_some_frames() -> None:
    for step in (2, 3, 4, 8):
        seen = np.unique(np.concatenate([columns_of(960, step, phase_of(index, step)) for index in range(8)]))
        assert len(seen) == 960


def test_both_halves_are_sent_where_they_are_fired_in_turns() -> None:
    frame = FRAMES["three to one"]
    columns = lattice_of(frame, 4)
    for half in frame.fired:
        assert half[columns].sum() >= half.sum() // 4


@given(st.binary(max_size=80))
def test_no_section_raises_anything_but_our_own_errors(data: bytes) -> None:
    try:
        lattice = read_lattice(data)
    except DecodeError:
        return
    assert len(lattice.columns) <= lattice.width


@pytest.mark.drawn
def test_damaged_sections_are_refused() -> None:
    encoder = StreamEncoder(StreamSettings(reduction="lattice:4"))
    (message,) = encoder.encode(FRAMES["scene"])
    rng = np.random.default_rng(5)
    good = next(section for section in message.sections if section.type == SectionType.LATTICE)
    for _ in range(examples(300)):
        data = bytearray(good.data)
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        damaged = good._replace(data=bytes(data[: rng.integers(len(data) + 1)] if rng.random() < 0.3 else data))
        sections = tuple(damaged if one is good else one for one in message.sections)
        try:
            StreamDecoder().decode(unpack(pack(replace(message, sections=sections))))
        except LidarCodecError:
            continue
    narrow = thinned(on_lattice(FRAMES["scene"], 4))
    with pytest.raises(SectionError, match="a lattice of 3 columns for a frame"):
        expanded(narrow, Lattice(12, columns_of(12, 8)))


def test_a_lattice_without_columns_is_refused() -> None:
    with pytest.raises(SectionError, match="without columns for a frame of 12"):
        read_lattice(lattice_bytes(Lattice(12, np.empty(0, np.uint16))))
    assert read_lattice(lattice_bytes(Lattice(0, np.empty(0, np.uint16)))).width == 0


@given(st.lists(st.integers(0, 35999), min_size=1, max_size=6), st.data())
def test_azimuths_between_columns_are_the_nearest_on_a_straight_line(azimuths: list[int], data: st.DataObject) -> None:
    """As the format says it: by fractions, the short way round, a half to the even number."""
    gaps = data.draw(st.lists(st.integers(1, 9), min_size=len(azimuths) + 1, max_size=len(azimuths) + 1))
    columns = np.cumsum(gaps[:-1]).astype(np.uint16) - 1
    width = int(columns[-1]) + gaps[-1]
    narrow = made.scene(1).with_(
        **{name: np.zeros((64, len(columns)), kind) for name, kind in (("range", np.uint16), ("intensity", np.uint8))},
        azimuth=np.array([azimuths, azimuths], np.uint16),
        fired=np.ones((2, len(columns)), np.bool_),
        side=None,
    )
    wide = expanded(narrow, Lattice(width, columns)).azimuth
    for column in range(width):
        left = max(int(np.searchsorted(columns, column, side="right")) - 1, 0)
        right = min(left + (column > columns[left]), len(columns) - 1)
        part = Fraction(int(column) - int(columns[left]), max(int(columns[right]) - int(columns[left]), 1))
        way = (azimuths[right] - azimuths[left] + 18000) % 36000 - 18000
        assert wide[0, column] == wide[1, column] == round(azimuths[left] + max(part, Fraction(0)) * way) % 36000


@given(st.integers(1, 65535), st.integers(1, 64), st.data())
def test_what_is_made_up_lies_between_its_neighbours(a: int, gap: int, data: st.DataObject) -> None:
    near = data.draw(st.integers(max(1, a - JUMP), min(65535, a + JUMP)))
    place = data.draw(st.integers(0, gap))
    (made_up,) = between(np.array([a]), np.array([near]), place, gap)
    assert min(a, near) <= made_up <= max(a, near)


@given(st.integers(500, 65535), st.integers(1, 64), st.integers(1, 64), st.data())
def test_what_lies_beyond_a_return_is_on_one_line_with_the_one_before(
    a: int, gap: int, place: int, data: st.DataObject
) -> None:
    before = data.draw(st.integers(max(1, a - JUMP), min(65535, a + JUMP)))
    (on,) = beyond(np.array([a]), np.array([before]), place, gap)
    if on == 0:
        assert before * gap <= (a - before) * place, "the line leads away for good"
    elif on <= 65535:
        (back,) = between(np.array([before]), np.array([on]), gap, gap + place)
        assert abs(int(back) - a) <= 1


def wall(width: int = 200, nearest: float = 0.3, pole: bool = True) -> Frame:
    """A wall seen aslant, 10 m away at the angle `nearest` (radians), with a pole in front of it."""
    base = made.scene(width // 6 + 1)
    angle = np.radians(np.arange(base.width) * 0.17)
    away = np.rint(5000 / np.cos(angle - nearest)).astype(np.uint16)
    ranges = np.broadcast_to(away, base.range.shape).copy()
    if pole:
        ranges[:, 88:90] = 2000
    return base.with_(range=ranges, intensity=np.full(base.range.shape, 40, np.uint8))


def test_a_wall_is_filled_in_to_the_millimetre_and_a_pole_before_it_stays_a_pole() -> None:
    """A viewer sees no holes beside edges, and nothing that hangs in the air between two surfaces."""
    frame = wall()
    back, sent = through(frame)
    assert back.filled is not None
    assert back.filled.sum() > 0.8 * frame.range.size
    assert {80, 88, 96} <= set(sent.lattice.tolist())
    shown = wall(pole=False).range.copy()
    shown[:, 85:92] = 2000  # half of the gap on either side; midway it is the wall
    assert np.abs(back.range.astype(int) - shown).max() <= 4
    assert back.range.all(), "there is no hole beside the pole"
    assert np.array_equal(measured_only(back).range, sent.range)
    assert filled(back) is back


def test_a_wall_seen_at_a_flat_angle_is_a_wall_and_no_stairs() -> None:
    """Neighbours differ by more than a twentieth there: what says that it is one wall is the return before them."""
    frame = wall(nearest=-0.75, pole=False)
    back, sent = through(frame)
    far = frame.range[0, sent.lattice].astype(int)
    assert (np.diff(far) > JUMP + far[:-1] // JUMP_SHARE).sum() > 5
    off = np.abs(back.range.astype(int) - frame.range)[:, : sent.lattice[-1]]
    assert (off / frame.range[:, : sent.lattice[-1]]).max() < 0.02
    assert np.all(np.diff(back.range[0].astype(int)) > 0), "no stairs"


def test_nothing_is_made_up_farther_than_the_farthest_return() -> None:
    """A range has 16 bits with this sensor: beyond them a decoder of another language would begin anew at nothing."""
    away = np.linspace(60000, 65535, wall().width).astype(np.uint16)
    frame = wall().with_(range=np.broadcast_to(away, wall().range.shape).copy())
    frame = frame.with_(range=np.where(np.arange(frame.width) == frame.width - 1, np.uint16(0), frame.range))
    back, sent = through(frame)
    assert int(back.range.max()) == int(sent.range.max()) < 65535
    assert np.all(np.diff(back.range[0, : int(sent.lattice[-2]) + 1].astype(int)) >= 0)


def through(frame: Frame) -> tuple[Frame, Frame]:
    """The frame as a receiver shows it when every eighth column was sent, and as it was received."""
    sent = expanded(thinned(on_lattice(frame, 8)), Lattice(frame.width, lattice_of(frame, 8), frame.side))
    return filled(sent), sent


def test_beside_a_hole_a_return_stands_for_half_of_the_gap() -> None:
    frame = wall().with_(range=np.full(wall().range.shape, 3000, np.uint16))
    ranges = frame.range.copy()
    ranges[:, 80:] = 0
    frame = frame.with_(range=ranges, intensity=np.where(ranges > 0, np.uint8(40), np.uint8(0)))
    back, _ = through(frame)
    last = int(back.lattice[back.lattice < 80].max())
    first_hole = last + 5  # four columns, with the one midway
    assert np.all(back.range[:, last:first_hole] == 3000)
    assert np.all(back.intensity[:, :first_hole] == 40)
    assert not back.range[:, first_hole:].any()
    assert not back.intensity[:, first_hole:].any()


def test_packets_hold_nothing_that_a_receiver_made_up() -> None:
    frame = api.read_frames("sim:city?frames=1")
    (message,) = StreamEncoder(StreamSettings(reduction="lattice:8"), 1).encode(next(frame))
    (back,) = StreamDecoder().decode(message)
    assert packets_of(filled(back)) == packets_of(back)


def test_a_filled_frame_is_sent_as_it_was_measured() -> None:
    frame = wall()
    (message,) = StreamEncoder(StreamSettings(reduction="lattice:8"), 1).encode(frame)
    (back,) = StreamDecoder().decode(message)
    (again,) = StreamEncoder(StreamSettings(), 1).encode(filled(back))
    (twice,) = StreamDecoder().decode(again)
    assert np.array_equal(twice.range, back.range)
