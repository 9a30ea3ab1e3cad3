"""What a program in C would lose of pictures: a range, a second return, a plane beside, or an honest error."""

from __future__ import annotations

import random
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.errors import DecodeError, SectionError, UnsupportedVersionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.ranges.image.jxl_file import read_jxl
from lidarcodec.settings import settings_from
from tests.clients.c_session import CSession, Picture
from tests.clients.test_c_library import alike
from tests.codecs.test_other_sensors import SMALL
from tests.codecs.test_other_sensors_pictures import far_frame, framed
from tests.conftest import ROOT
from tests.fuzz.mutations import mutated
from tests.vectors.make import split

WOUNDED = (SectionType.RANGE, SectionType.PLANES)
NUMBERS = {name: table.codec_id(name) for name in ("png", "jxl")}


def open_jxl(picture: Picture) -> npt.NDArray[np.uint16]:
    """As a program would by libjxl."""
    assert picture.bits == 16
    return read_jxl(picture.data, picture.rows, picture.width)


@pytest.fixture
def session(bare: CSession) -> CSession:
    """A session whose program opens JPEG XL."""
    bare.give_pictures(NUMBERS["jxl"], open_jxl)
    return bare


@cache
def messages(codec: str, capture: str, **settings: Any) -> list[Message]:
    """Two short frames of a capture."""
    encoder = StreamEncoder(settings_from({"codec": codec, **settings}), 7)
    frames = [framed(capture, skip=16 * at).with_(index=at) for at in range(2)]
    return [message for frame in frames for message in encoder.encode(frame)]


def decoded(coded: list[Message], session: CSession) -> list[Frame]:
    """The frames of messages, which must be the same here and there."""
    decoder, found = StreamDecoder(), []
    for message in coded:
        (frame,) = decoder.decode(message)
        alike(frame, session.push(wire.pack(message)))
        found.append(frame)
    return found


@pytest.mark.parametrize("codec", NUMBERS)
@pytest.mark.parametrize("capture", SMALL)
@pytest.mark.parametrize(
    "settings",
    [{}, {"max_error_m": 0.05, "intensity": "levels=4"}, {"reduction": "lattice:3"}, {"reduction": "random"}],
    ids=["exact", "bound", "lattice", "random"],
)
def test_planes_and_points_are_those_of_the_package(
    codec: str, capture: str, settings: dict[str, Any], session: CSession
) -> None:
    for frame in decoded(messages(codec, capture, **settings), session):
        assert frame.points > 0


@pytest.mark.parametrize("codec", NUMBERS)
@pytest.mark.parametrize("bound", [None, 0.003, 20.0])
def test_ranges_beyond_65_m_and_second_ones_of_any_number(codec: str, bound: float | None, session: CSession) -> None:
    encoder = StreamEncoder(settings_from({"codec": codec, "max_error_m": bound}), 7)
    (frame,) = decoded(encoder.encode(far_frame()), session)
    assert frame.range.max() > 1 << 18


@pytest.mark.parametrize("codec", NUMBERS)
def test_frames_without_a_return_and_without_an_image(codec: str, session: CSession) -> None:
    encoder = StreamEncoder(settings_from({"codec": codec}), 7)
    frame = framed(SMALL[0])
    none = np.zeros_like(frame.range)
    empty = frame.with_(range=none, planes={**frame.planes, "range2": none.astype(frame.planes["range2"].dtype)})
    assert decoded(encoder.encode(empty), session)[0].points == 0


def test_pictures_that_nobody_opens_are_refused_by_name(bare: CSession) -> None:
    for codec in ("jxl", "jpeg"):
        with pytest.raises(UnsupportedVersionError, match=codec):
            bare.push(wire.pack(messages(codec, SMALL[0])[0]))
    bare.give_pictures(NUMBERS["jxl"], open_jxl)
    decoded(messages("jxl", SMALL[0]), bare)
    bare.give_pictures(NUMBERS["jxl"], None)
    with pytest.raises(UnsupportedVersionError, match="jxl"):
        bare.push(wire.pack(messages("jxl", SMALL[0])[0]))
    for number in (1, 3, 10, 11, 99):  # others have no pictures
        with pytest.raises(UnsupportedVersionError, match=f"no codec {number} of pictures"):
            bare.give_pictures(number, open_jxl)


def test_a_picture_that_the_program_cannot_open_is_damage(bare: CSession) -> None:
    bare.give_pictures(NUMBERS["jxl"], lambda picture: read_jxl(picture.data, picture.rows + 1, picture.width))
    coded = messages("jxl", SMALL[0])
    with pytest.raises(SectionError, match="damaged picture of codec jxl"):
        bare.push(wire.pack(coded[0]))
    bare.give_pictures(NUMBERS["jxl"], open_jxl)
    decoded(coded, bare)


@pytest.mark.parametrize("codec", NUMBERS)
@pytest.mark.parametrize("capture", SMALL)
def test_mutated_messages_end_as_in_the_package(codec: str, capture: str, session: CSession) -> None:
    """Frames alike, or an error of the same class, and whole messages are decoded after them."""
    coded, rng, refused = messages(codec, capture), random.Random(5), 0
    for number in range(60):
        at = rng.choice([at for at, one in enumerate(coded[0].sections) if one.type in WOUNDED])
        sections = list(coded[0].sections)
        sections[at] = sections[at]._replace(data=mutated(sections[at].data, rng))
        data = wire.pack(replace(coded[0], sections=tuple(sections)))
        decoder = StreamDecoder()
        try:
            (frame,) = decoder.decode(wire.unpack(data))
        except DecodeError as error:
            with pytest.raises(type(error)):
                session.push(data)
            refused += 1
        else:
            alike(frame, session.push(data))
        if number % 10 == 0:
            decoded(coded, session)
    assert refused > 30


def test_golden_pictures_of_an_hdl64e_come_without_a_program_s_help(bare: CSession) -> None:
    for name in ("lossless", "coarse"):
        data = split((ROOT / f"tests/golden/v1_png_{name}.bin").read_bytes())
        assert len(decoded([wire.unpack(one) for one in data], bare)) > 3
