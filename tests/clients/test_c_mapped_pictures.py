"""Codecs of pictures that keep no bound, and jxl of an HDL-64E, by the C library, whose pictures its program opens."""

from __future__ import annotations

import random
from dataclasses import replace
from functools import cache
from itertools import islice
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pytest

from lidarcodec import wire
from lidarcodec.codecs import table
from lidarcodec.errors import DecodeError, MissingReferenceError, SectionError, UnsupportedVersionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, SectionType
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.ranges.image.jpeg_file import read_jpeg
from lidarcodec.ranges.video.h264_stream import PictureReader
from lidarcodec.settings import settings_from
from lidarcodec.sources import open_source
from tests.clients.c_session import CSession, Picture
from tests.clients.test_c_library import alike
from tests.clients.test_c_pictures import open_jxl
from tests.codecs.test_other_sensors import FILES, SMALL, opened
from tests.codecs.test_other_sensors_pictures import ODD_ROWS, far_frame, framed
from tests.conftest import ROOT, data_folder
from tests.fuzz.mutations import mutated
from tests.sensors.captures import CAPTURES
from tests.sweeps import examples, paired, sampled, spread
from tests.vectors.make import split

STILL: Final = ("jpeg", "jpeg-layered")
VIDEO: Final = ("h264", "h264-log")
MAPPED: Final = (*STILL, *VIDEO)
NUMBERS: Final = {name: table.codec_id(name) for name in ("jxl", *MAPPED)}
HDL64E: Final = ("HDL-64E S2", "HDL-64E S3")
WOUNDED: Final = (SectionType.RANGE, SectionType.PLANES, SectionType.MASK, SectionType.LATTICE)


def open_jpeg(picture: Picture) -> npt.NDArray[np.uint16]:
    """As a program would by libjpeg-turbo 3."""
    return read_jpeg(picture.data, picture.rows, picture.width, picture.bits)


class Films:
    """As a program would by FFmpeg: the decoder of a stream, which begins anew with each IDR picture."""

    def __init__(self) -> None:
        self._reader: PictureReader | None = None

    def open(self, picture: Picture) -> npt.NDArray[np.uint16]:
        if picture.begins:
            self._reader = PictureReader(picture.rows, picture.width, picture.bits)
        assert self._reader is not None
        assert (self._reader.shape, self._reader.bits) == ((picture.rows, picture.width), picture.bits)
        return self._reader.read(picture.data, idr=picture.begins)


@pytest.fixture
def session(bare: CSession) -> CSession:
    """A session whose program opens all pictures."""
    bare.give_pictures(NUMBERS["jxl"], open_jxl)
    for name in STILL:
        bare.give_pictures(NUMBERS[name], open_jpeg)
    for name in VIDEO:
        bare.give_pictures(NUMBERS[name], Films().open)
    return bare


@cache
def frames(capture: str) -> tuple[Frame, ...]:
    """Three short frames of a capture."""
    if capture not in HDL64E:
        return tuple(framed(capture, skip=16 * at).with_(index=at) for at in range(3))
    path = data_folder() / CAPTURES[capture]
    if not path.exists():
        pytest.skip(f"needs {CAPTURES[capture]} in LIDARCODEC_DATA (looked in {data_folder()})")
    with open_source(path) as source:
        return tuple(islice(frames_of(source.packets(), source.sensor, "packets:29"), 3))


def standing(capture: str) -> tuple[Frame, ...]:
    """The first one three times: a video of it refers to the picture before."""
    first = frames(capture)[0]
    return tuple(first.with_(index=at) for at in range(3))


def coded(codec: str, sent: tuple[Frame, ...], **settings: Any) -> list[Message]:
    """Their messages; groups are of two frames."""
    own = {"group": 2, **settings.pop("own", {})} if codec == "jpeg-layered" else settings.pop("own", {})
    encoder = StreamEncoder(settings_from({"codec": codec, "codec_settings": own, **settings}), 7)
    return [message for frame in sent for message in encoder.encode(frame)] + encoder.flush()


def decoded(messages: list[Message], session: CSession) -> list[Frame]:
    """The frames of messages, which must be the same here and there."""
    decoder, all_of_them = StreamDecoder(), []
    for message in messages:
        wanted, found = decoder.decode(message), session.push_all(wire.pack(message))
        for frame, other in zip(wanted, found, strict=True):
            alike(frame, other)
        assert not session.next_unseen()
        all_of_them += wanted
    return all_of_them


SETTINGS: Final[dict[str, dict[str, Any]]] = {
    "plain": {},
    "levels": {"intensity": "levels=4"},
    "no intensity": {"intensity": "off"},
    "lattice": {"reduction": "lattice:3"},
    "random": {"reduction": "random"},
}


@pytest.mark.parametrize(("codec", "capture", "settings"), paired(MAPPED, [*SMALL, ODD_ROWS, *HDL64E], SETTINGS))
def test_planes_and_points_are_those_of_the_package(codec: str, capture: str, settings: str, session: CSession) -> None:
    found = decoded(coded(codec, frames(capture), **SETTINGS[settings]), session)
    assert len(found) == 3
    assert all(frame.points > 0 for frame in found)


@pytest.mark.parametrize(("capture", "codec"), spread(FILES, MAPPED))
def test_every_capture(capture: str, codec: str, session: CSession) -> None:
    sensor, packets = opened(FILES[capture])
    sent = tuple(frames_of(packets[:48], sensor, "packets:16"))
    assert [frame.index for frame in decoded(coded(codec, sent), session)] == [frame.index for frame in sent]


@pytest.mark.parametrize("capture", HDL64E)
@pytest.mark.parametrize(
    "settings", [{}, {"max_error_m": 0.05}, {"reduction": "lattice:3"}], ids=["", "bound", "lattice"]
)
def test_jxl_of_an_hdl64e_is_that_of_the_package(capture: str, settings: dict[str, Any], session: CSession) -> None:
    assert len(decoded(coded("jxl", frames(capture), **settings), session)) == 3


MAPPINGS: Final = [
    *(
        (codec, {"mapping": mapping, "bits": bits})
        for codec in STILL
        for mapping in ("linear", "sqrt", "log")
        for bits in (8, 12)
    ),
    *(("h264", {"mapping": mapping, "bits": bits}) for mapping in ("linear", "sqrt", "log") for bits in (8, 10)),
    *(("h264-log", {"mapping": mapping, "bits": bits}) for mapping in ("log", "paper") for bits in (8, 10)),
    ("jpeg", {"tables": "libjpeg"}),
]


@pytest.mark.parametrize(("codec", "own"), MAPPINGS, ids=str)
@pytest.mark.parametrize("capture", sampled([ODD_ROWS, SMALL[2], HDL64E[0]], [ODD_ROWS]))
def test_every_mapping_and_depth(codec: str, own: dict[str, Any], capture: str, session: CSession) -> None:
    """Steps of 4 mm, 1 mm and 2 mm: whole octaves of `paper` lie between two of the first."""
    assert len(decoded(coded(codec, frames(capture), own=own), session)) == 3


@pytest.mark.parametrize("codec", MAPPED)
def test_ranges_beyond_65_m_and_second_ones_of_any_number(codec: str, session: CSession) -> None:
    (frame,) = decoded(coded(codec, (far_frame(),)), session)
    assert frame.range.max() > 1 << 18


@pytest.mark.parametrize("codec", MAPPED)
@pytest.mark.parametrize("capture", [SMALL[0], SMALL[2], HDL64E[0]])
def test_frames_without_a_return_between_others(codec: str, capture: str, session: CSession) -> None:
    first, second, third = frames(capture)
    planes = {name: np.zeros_like(plane) if name == "range2" else plane for name, plane in second.planes.items()}
    empty = second.with_(range=np.zeros_like(second.range), planes=planes)
    assert [frame.points > 0 for frame in decoded(coded(codec, (first, empty, third)), session)] == [True, False, True]
    assert decoded(coded(codec, (empty,)), session)[0].points == 0


def test_golden_pictures_of_an_hdl64e(session: CSession) -> None:
    for path in sorted((ROOT / "tests/golden").glob("v1_*.bin")):
        if path.stem.split("_")[1] in NUMBERS:
            data = split(path.read_bytes())
            assert len(decoded([wire.unpack(one) for one in data], session)) > 3, path


@pytest.mark.parametrize("codec", NUMBERS)
@pytest.mark.parametrize("capture", [SMALL[0], HDL64E[0]])
def test_pictures_that_nobody_opens_are_refused_by_name(codec: str, capture: str, bare: CSession) -> None:
    message = coded(codec, frames(capture)[:1])[0]
    with pytest.raises(UnsupportedVersionError, match=f"codec {codec} needs a decoder of pictures"):
        bare.push(wire.pack(message))


@pytest.mark.parametrize("codec", MAPPED)
@pytest.mark.parametrize("capture", [SMALL[0], HDL64E[0]])
def test_a_picture_that_the_program_cannot_open_is_damage(codec: str, capture: str, session: CSession) -> None:
    """Of a video the next one that refers to it asks for a key frame."""
    asked, films = [], Films()

    def open_most(picture: Picture) -> npt.NDArray[np.uint16]:
        asked.append(picture)
        if len(asked) == 2:
            raise SectionError("not this one")
        return open_jpeg(picture) if codec in STILL else films.open(picture)

    session.give_pictures(NUMBERS[codec], open_most)
    messages = coded(codec, standing(capture), own={"group": 1} if codec == "jpeg-layered" else {})
    session.push(wire.pack(messages[0]))
    with pytest.raises(SectionError, match=f"damaged picture of codec {codec}"):
        session.push(wire.pack(messages[1]))
    if codec in VIDEO:
        with pytest.raises(MissingReferenceError) as missing:
            session.push(wire.pack(messages[2]))
        assert missing.value.needs == messages[1].frame_index
    assert len(decoded(messages, session)) == 3


@pytest.mark.parametrize("codec", MAPPED)
def test_samples_of_more_bits_than_the_message_says_are_damage(codec: str, session: CSession) -> None:
    session.give_pictures(NUMBERS[codec], lambda one: np.full((one.rows, one.width), 1 << one.bits, np.uint16))
    with pytest.raises(SectionError, match="beyond"):
        session.push(wire.pack(coded(codec, frames(SMALL[0])[:1])[0]))


@pytest.mark.parametrize("codec", VIDEO)
@pytest.mark.parametrize("capture", [SMALL[0], HDL64E[0]])
def test_a_picture_whose_reference_was_lost_asks_for_it(codec: str, capture: str, session: CSession) -> None:
    first, second, third = coded(codec, standing(capture))
    assert second.needs is not None
    decoded([first], session)
    with pytest.raises(MissingReferenceError) as missing:
        session.push(wire.pack(third))
    assert missing.value.needs == third.needs
    decoded([first, second, third], session)
    session.push(wire.pack(coded("jpeg", frames(capture)[:1])[0]))
    with pytest.raises(MissingReferenceError):  # another codec came between
        session.push(wire.pack(replace(third, frame_index=9, needs=third.frame_index)))


@pytest.mark.parametrize("capture", [SMALL[0], HDL64E[0]])
def test_a_damaged_message_of_another_codec_ends_what_came_before_too(capture: str, session: CSession) -> None:
    """As in the package: each codec begins with a key message."""
    key, other = coded("jpeg", frames(capture))[:2]
    group = coded("jpeg-layered", frames(capture))[0]
    cut = tuple(one._replace(data=b"\x10") if one.type == SectionType.RANGE else one for one in group.sections)
    session.push(wire.pack(key))
    with pytest.raises(DecodeError):
        session.push(wire.pack(replace(group, sections=cut)))
    with pytest.raises(MissingReferenceError):
        session.push(wire.pack(other))


@pytest.mark.parametrize("codec", [*MAPPED, "jxl"])
@pytest.mark.parametrize("capture", [SMALL[0], SMALL[2], *HDL64E])
def test_mutated_messages_end_as_in_the_package(codec: str, capture: str, session: CSession) -> None:
    """Frames alike, or an error of the same class, and whole messages are decoded after them."""
    sent = standing(capture) if codec in VIDEO else frames(capture)
    messages, rng, refused, count = coded(codec, sent), random.Random(5), 0, examples(160)
    for number in range(count):
        before = messages[: number % len(messages)]
        message = messages[len(before)]
        at = rng.choice([at for at, one in enumerate(message.sections) if one.type in WOUNDED])
        sections = list(message.sections)
        data = sections[at].data
        size = rng.choice([len(data), min(len(data), 60)])  # its head is wounded as often as the rest
        sections[at] = sections[at]._replace(data=mutated(data[:size], rng) + data[size:])
        decoder = StreamDecoder()
        for one in before:
            decoder.decode(one)
            session.push(wire.pack(one))
        hurt = wire.pack(replace(message, sections=tuple(sections)))
        try:
            wanted = decoder.decode(wire.unpack(hurt))
        except DecodeError as error:
            with pytest.raises(type(error)):
                session.push(hurt)
            refused += 1
        else:
            for frame, found in zip(wanted, session.push_all(hurt), strict=True):
                alike(frame, found)
        if number % 10 == 0:
            decoded(messages, session)
    assert refused > count // 4
