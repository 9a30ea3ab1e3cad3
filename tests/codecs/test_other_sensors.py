"""What a user of another sensor than an HDL-64E would lose here: one byte of a packet, or a bound that was promised."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import islice

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.assembly import packets_of
from lidarcodec.codecs.other_sensors import KINDS
from lidarcodec.entropy.rest_coder import decode_rest, encode_rest
from lidarcodec.errors import DecodeError, SectionError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.planes.other_calibrations import other_form
from lidarcodec.planes.plane_section import PlaneKind, decode_plane_section, encode_plane_section, read_head
from lidarcodec.sensor_model import POINTCLOUD2, SensorModel
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.sensors.models.table import PACKETS, any_packets, names, sensor_named
from lidarcodec.settings import MAX_BOUND_M, settings_from
from lidarcodec.sources import open_source
from tests.conftest import data_folder
from tests.fuzz.mutations import mutated
from tests.point_clouds import message, velodyne
from tests.sensors.captures import CAPTURES
from tests.sensors.made_frames import made_frames, made_layouts
from tests.sensors.ouster_packets import CAPTURES as OUSTERS
from tests.sensors.ouster_packets import FOLDER
from tests.sweeps import examples, sampled, spread

FILES = {name: file for name, file in CAPTURES.items() if not name.startswith(("HDL-64E", "OS-"))}
FILES |= {name: f"{FOLDER}/{name}.pcap.xz" for name in OUSTERS}
SMALL = ("vlp16", "xt32m", "OS-0-32-U1_v2.2.0_1024x10")
"""A Velodyne with two returns, a Hesai, an Ouster."""
MOST = 700


@lru_cache(maxsize=4)
def opened(file: str) -> tuple[SensorModel, tuple[Packet, ...]]:
    """Sensor and first packets of a capture."""
    path = data_folder() / file
    if not path.exists():
        pytest.skip(f"needs {file} in LIDARCODEC_DATA (looked in {data_folder()})")
    with open_source(path) as source:
        return source.sensor, tuple(islice(source.packets(), MOST))


def sent(packets: Sequence[Packet], sensor: SensorModel, settings: dict[str, object]) -> list[tuple[Frame, Frame]]:
    """Pairs of a frame and what a receiver has of it."""
    encoder, decoder = StreamEncoder(settings_from(settings), 7), StreamDecoder()
    pairs = []
    for frame in frames_of(packets, sensor):
        (message,) = encoder.encode(frame)
        (decoded,) = decoder.decode(wire.unpack(wire.pack(message)))
        pairs.append((frame, decoded))
    return pairs


def in_microseconds(packets: Sequence[Packet]) -> list[tuple[bytes, bool]]:
    return [(packet.payload, packet.position) for packet in packets]


def assert_exact(packets: Sequence[Packet], sensor: SensorModel, codec: str) -> list[tuple[Frame, Frame]]:
    """All packets come back in their order, byte for byte, and their times within half a microsecond."""
    pairs = sent(packets, sensor, {"codec": codec})
    back = [packet for _, decoded in pairs for packet in packets_of(decoded)]
    assert in_microseconds(back) == in_microseconds(packets)
    assert max(abs(one.stamp_ns - two.stamp_ns) for one, two in zip(back, packets, strict=True)) <= 500
    return pairs


@pytest.mark.parametrize(("capture", "codec"), spread(FILES, KINDS))
def test_every_packet_of_every_capture_comes_back(capture: str, codec: str) -> None:
    sensor, packets = opened(FILES[capture])
    assert not sensor.is_hdl64e
    pairs = assert_exact(packets, sensor, codec)
    for frame, decoded in pairs:
        assert decoded.width > 0
        assert (decoded.sensor.model, decoded.sensor.hash) == (sensor.model, sensor.hash)
        np.testing.assert_array_equal(decoded.azimuth, frame.azimuth)
        assert list(decoded.planes) == list(frame.planes)


@pytest.mark.parametrize("codec", KINDS)
@pytest.mark.parametrize("capture", SMALL)
def test_a_bound_is_kept_at_every_return(capture: str, codec: str) -> None:
    sensor, packets = opened(FILES[capture])
    for frame, decoded in sent(packets[:200], sensor, {"codec": codec, "max_error_m": 0.05}):
        for name in ("range", "range2"):
            before = frame.range if name == "range" else frame.planes.get(name)
            after = decoded.range if name == "range" else decoded.planes.get(name)
            if before is None or after is None:
                assert before is after
                continue
            np.testing.assert_array_equal(after > 0, before > 0)
            off = np.abs(after.astype(np.int64) - before.astype(np.int64))
            assert 0 < int(off.max()) * sensor.range_step_m <= 0.05
        np.testing.assert_array_equal(decoded.intensity, frame.intensity)


@pytest.mark.parametrize("codec", KINDS)
@pytest.mark.parametrize("capture", SMALL)
def test_the_largest_bound_loses_no_return(capture: str, codec: str) -> None:
    sensor, packets = opened(FILES[capture])
    for frame, decoded in sent(packets[:200], sensor, {"codec": codec, "max_error_m": MAX_BOUND_M}):
        np.testing.assert_array_equal(decoded.range > 0, frame.range > 0)
        off = np.abs(decoded.range.astype(np.int64) - frame.range.astype(np.int64))
        assert int(off.max(initial=0)) * sensor.range_step_m <= MAX_BOUND_M


@pytest.mark.parametrize("codec", KINDS)
@pytest.mark.parametrize("capture", SMALL)
def test_without_intensity_the_ranges_are_still_exact(capture: str, codec: str) -> None:
    sensor, packets = opened(FILES[capture])
    for frame, decoded in sent(packets[:200], sensor, {"codec": codec, "intensity": "off"}):
        np.testing.assert_array_equal(decoded.range, frame.range)
        assert not decoded.intensity.any()
        assert set(decoded.planes) <= {"range2"}
        assert len(decoded.cloud()) == len(frame.cloud())
        assert len(packets_of(decoded)) == len(packets_of(frame))


def disturbed(packets: Sequence[Packet], rng: random.Random) -> list[Packet]:
    """Packets of a bad line: cut, longer, damaged, twice, in another order, and foreign ones in between.

    Those of another port stay as they are: longer ones than any sensor sends are counted there, and not kept.
    """
    found: list[Packet] = []
    for packet in packets:
        if packet.position:
            found.append(packet)
            continue
        payload = packet.payload
        match rng.randrange(12):
            case 0:
                found.append(packet._replace(payload=payload[: rng.randrange(len(payload))]))
            case 1:
                found.append(packet._replace(payload=payload + rng.randbytes(rng.randrange(1, 2000))))
            case 2:
                found.append(packet._replace(payload=mutated(payload, rng)))
            case 3:
                found += [packet, packet]
            case 4:
                found.append(packet._replace(payload=rng.randbytes(len(payload))))
            case 5:
                found.insert(rng.randrange(len(found) + 1), packet)
            case 6:
                found.append(packet._replace(payload=rng.choice((b"", b"\0", bytes(1206), bytes(65_507)))))
            case _:
                found.append(packet)
    return found


OWN_TESTS = ("hdl64e", POINTCLOUD2, PACKETS)


@pytest.mark.parametrize("codec", KINDS)
@pytest.mark.parametrize("capture", sampled(FILES, SMALL))
def test_packets_of_a_bad_line_come_back_too(capture: str, codec: str) -> None:
    sensor, packets = opened(FILES[capture])
    assert_exact(disturbed(packets[:150], random.Random(3)), sensor, codec)


@pytest.mark.parametrize("codec", KINDS)
@pytest.mark.parametrize("model", [name for name in names() if name not in OWN_TESTS and "os" not in name])
def test_a_frame_of_foreign_packets_alone_comes_back(model: str, codec: str) -> None:
    rng = random.Random(5)
    packets = [Packet(rng.randbytes(size), 10**18 + k) for k, size in enumerate((0, 1, 568, 1206, 1206, 1500, 20_000))]
    pairs = assert_exact(packets, sensor_named(model).generic_sensor, codec)
    assert [decoded.width for _, decoded in pairs] == [0] * len(pairs)
    assert all(len(decoded.cloud()) == 0 for _, decoded in pairs)


@pytest.mark.parametrize("codec", KINDS)
def test_messages_that_are_no_clouds_come_back_too(codec: str) -> None:
    rng = random.Random(6)
    packets = [Packet(rng.randbytes(size), 10**18 + k) for k, size in enumerate((0, 1, 568, 20_000))]
    packets.append(Packet(message(velodyne(20)), 10**18 + 9))
    pairs = assert_exact(packets, cloud_sensor([packets[-1].payload]), codec)
    assert [decoded.width > 0 for _, decoded in pairs] == [False] * 4 + [True]


@pytest.mark.parametrize("codec", KINDS)
def test_any_payloads_come_back_with_model_packets(codec: str) -> None:
    rng = random.Random(8)
    packets = [Packet(rng.randbytes(rng.choice((0, 1, 100, 1206, 9000))), 10**18 + 1000 * k) for k in range(300)]
    packets += [Packet(bytes(65_507), 10**18 + 10**9)]
    assert_exact(packets, any_packets(), codec)


@pytest.mark.parametrize("reduction", ["voxel", "poconet", "poconet-paper"])
def test_packets_without_images_have_nothing_to_reduce_and_come_back(reduction: str) -> None:
    if reduction != "voxel":
        pytest.importorskip("onnxruntime", reason="the extra `poconet`")
    frame = next(iter(frames_of([Packet(bytes(10), 0)], any_packets())))
    (message,) = StreamEncoder(settings_from({"codec": "predictive", "reduction": reduction}), 1).encode(frame)
    (decoded,) = StreamDecoder().decode(message)
    assert [packet.payload for packet in packets_of(decoded)] == [bytes(10)]


def used(message: Message) -> None:
    """All that a receiver does with a message."""
    for decoded in StreamDecoder().decode(message):
        packets_of(decoded)
        decoded.cloud("all")


@pytest.mark.drawn
@pytest.mark.parametrize("codec", KINDS)
@pytest.mark.parametrize("capture", SMALL)
def test_damaged_messages_with_right_checksums_are_decode_errors(capture: str, codec: str) -> None:
    sensor, packets = opened(FILES[capture])
    frame = next(iter(frames_of(packets[:12], sensor, "packets:12")))
    (message,) = StreamEncoder(settings_from({"codec": codec}), 7).encode(frame)
    rng, found = random.Random(11), Counter[bool]()
    for _ in range(examples(150)):
        at = rng.randrange(len(message.sections))
        sections = list(message.sections)
        sections[at] = sections[at]._replace(data=mutated(sections[at].data, rng))
        damaged = replace(message, sections=tuple(sections), width=rng.choice((message.width, 0, message.width + 1)))
        try:
            used(wire.unpack(wire.pack(damaged)))
            found[True] += 1
        except DecodeError:
            found[False] += 1
    assert found[False] > examples(150) / 3


@pytest.mark.parametrize("capture", SMALL)
def test_a_message_that_lacks_a_series_or_has_it_too_short_is_a_decode_error(capture: str) -> None:
    sensor, packets = opened(FILES[capture])
    frame = next(iter(frames_of(packets[:12], sensor, "packets:12")))
    (message,) = StreamEncoder(settings_from({"codec": "raw"}), 7).encode(frame)
    rest = decode_rest(message.section(SectionType.REST), message.packets)
    for name in rest.series:
        for series in (
            {key: values for key, values in rest.series.items() if key != name},
            {**rest.series, name: rest.series[name][:-1].copy()},
            {**rest.series, name: np.append(rest.series[name], rest.series[name][:1])},
            {**rest.series, name: np.full(len(rest.series[name]), 2**64 - 1, np.uint64)},
        ):
            wrong = Section(SectionType.REST, encode_rest(replace(rest, series=series)))
            sections = tuple(wrong if one.type == SectionType.REST else one for one in message.sections)
            try:
                used(replace(message, sections=sections))
            except DecodeError:
                continue


def test_intensities_of_more_bits_than_any_frame_has_are_a_decode_error() -> None:
    sensor, packets = opened(FILES[SMALL[0]])
    frame = next(iter(frames_of(packets[:12], sensor, "packets:12")))
    (message,) = StreamEncoder(settings_from({"codec": "raw"}), 7).encode(frame)
    section = message.section(SectionType.PLANES)
    head, planes = read_head(section), decode_plane_section(section, message.width)
    forms = [form._replace(bits=17) if form.name == "intensity" else form for form in head.forms]
    wide = Section(SectionType.PLANES, encode_plane_section(PlaneKind.PLAIN, forms, planes, head.shift, 1))
    sections = tuple(wide if one.type == SectionType.PLANES else one for one in message.sections)
    with pytest.raises(SectionError, match="intensities of 17 bits, more than 16"):
        StreamDecoder().decode(replace(message, sections=sections))


@pytest.mark.parametrize("model", [sensor.model for sensor, layout in made_layouts() if layout.startswith("dual")])
def test_numbers_of_a_series_mean_the_same_in_any_type_that_holds_them(model: str) -> None:
    sensor, layout = next(one for one in made_layouts() if one[0].model == model)
    (frame,) = made_frames(sensor, layout, 2, 1)
    (coded,) = StreamEncoder(settings_from({"codec": "raw"}), 7).encode(frame)
    rest = decode_rest(coded.section(SectionType.REST), coded.packets)
    shown = []
    small = {name: values if name in ("mode", "status") else values % 251 for name, values in rest.series.items()}
    narrow = {name: values.astype(np.uint8) if int(values.max()) < 251 else values for name, values in small.items()}
    for series in (small, narrow):
        said = Section(SectionType.REST, encode_rest(replace(rest, series=series)))
        sections = tuple(said if one.type == SectionType.REST else one for one in coded.sections)
        (decoded,) = StreamDecoder().decode(replace(coded, sections=sections))
        shown.append((decoded.azimuth.tobytes(), decoded.cloud("all").tobytes(), in_microseconds(packets_of(decoded))))
    assert shown[0] == shown[1]


def test_an_hdl64e_among_other_sensors_is_a_decode_error() -> None:
    sensor, layout = made_layouts()[0]
    (frame,) = made_frames(sensor, layout, 1, 1)
    (coded,) = StreamEncoder(settings_from({"codec": "raw"}), 7).encode(frame)
    said = Section(SectionType.CALIBRATION, other_form(replace(sensor, model="hdl64e")))
    sections = tuple(said if one.type == SectionType.CALIBRATION else one for one in coded.sections)
    with pytest.raises(DecodeError, match="hdl64e"):
        StreamDecoder().decode(replace(coded, sections=sections))
