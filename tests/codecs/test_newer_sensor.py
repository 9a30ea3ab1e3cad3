"""What somebody who adds a sensor would lose here: its packets, before the native core is built anew."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from lidarcodec import _native, wire
from lidarcodec.assembly import packets_of
from lidarcodec.codecs.other_sensors import KINDS
from lidarcodec.entropy.rest_coder import decode_rest, encode_rest
from lidarcodec.errors import DecodeError, SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.sensors.models import table, vlp16
from lidarcodec.sensors.models.velodyne_packet import velodyne_layouts
from lidarcodec.settings import settings_from
from lidarcodec.sources.spinning.source import SpinningSource
from lidarcodec.sources.spinning.table import Wanted
from tests.fuzz.mutations import mutated
from tests.sweeps import examples

NEWER = replace(
    vlp16.SENSOR,
    name="newer",
    layouts=velodyne_layouts(0x2F, tuple(vlp16.SENSOR.channel_of_row.tolist())),
    shot_us=2.4,
)
"""A VLP-16 with a model byte and firing times of its own."""


@pytest.fixture
def packets(monkeypatch: pytest.MonkeyPatch) -> list[Packet]:
    monkeypatch.setitem(table._MODELS, NEWER.name, f"{__name__}:NEWER")
    assert not _native.knows_model(NEWER.name)
    return list(SpinningSource(Wanted(NEWER.name, returns="dual"), "street", frames=1).packets())


def message_of(frame: Frame, codec: str) -> Message:
    (message,) = StreamEncoder(settings_from({"codec": codec}), 7).encode(frame)
    return message


@pytest.mark.parametrize("codec", KINDS)
def test_packets_of_a_model_that_the_core_does_not_have_come_back(packets: list[Packet], codec: str) -> None:
    encoder, decoder = StreamEncoder(settings_from({"codec": codec}), 7), StreamDecoder()
    back = []
    for frame in frames_of(packets, NEWER.generic_sensor, "packets:40"):
        (message,) = encoder.encode(frame)
        (decoded,) = decoder.decode(wire.unpack(wire.pack(message)))
        assert (decoded.sensor.model, decoded.sensor.hash) == (NEWER.name, NEWER.generic_sensor.hash)
        assert np.array_equal(decoded.azimuth, frame.azimuth)
        ours, theirs = decoded.cloud("all"), frame.cloud("all")
        assert all(np.array_equal(ours[field], theirs[field]) for field in ("x", "y", "z", "ring", "return_number"))
        back += [packet.payload for packet in packets_of(decoded)]
    assert back == [packet.payload for packet in packets]


@pytest.mark.drawn
def test_its_damaged_messages_are_decode_errors(packets: list[Packet]) -> None:
    message = message_of(next(iter(frames_of(packets[:12], NEWER.generic_sensor, "packets:12"))), "zstd")
    rest = decode_rest(message.section(SectionType.REST), message.packets)
    short = {name: numbers[1:] for name, numbers in rest.series.items()}
    for wrong in (replace(rest, layout="triple"), replace(rest, series={}), replace(rest, series=short)):
        with pytest.raises(SectionError):
            StreamDecoder().decode(_with(message, SectionType.REST, encode_rest(wrong)))
    rng, refused = random.Random(11), 0
    for _ in range(examples(100)):
        section = rng.choice(message.sections)
        try:
            for frame in StreamDecoder().decode(_with(message, section.type, mutated(section.data, rng))):
                packets_of(frame)
        except DecodeError:
            refused += 1
    assert refused > 0.3 * examples(100)


def test_a_model_that_the_package_does_not_have_is_refused(
    packets: list[Packet], monkeypatch: pytest.MonkeyPatch
) -> None:
    message = message_of(next(iter(frames_of(packets[:12], NEWER.generic_sensor, "packets:12"))), "zstd")
    monkeypatch.delitem(table._MODELS, NEWER.name)
    with pytest.raises(SectionError, match="model 'newer', which this build does not know: update it"):
        StreamDecoder().decode(message)


def _with(message: Message, kind: int, data: bytes) -> Message:
    """The message with other bytes of a section."""
    sections = (Section(one.type, data, *one[2:]) if one.type == kind else one for one in message.sections)
    return replace(message, sections=tuple(sections))
