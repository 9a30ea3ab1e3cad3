"""What a user would lose here: single bytes of unusual packets, or an answer to damaged images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import SectionError
from lidarcodec.sensors.images import Images
from lidarcodec.sensors.models.table import block_sensors
from tests.sweeps import examples

SENSORS = {sensor.name: sensor for sensor in block_sensors()}
LAYOUTS = {f"{sensor.name} {layout.name}": layout for sensor in SENSORS.values() for layout in sensor.layouts}


@given(st.data())
@settings(deadline=None, max_examples=examples(200))
def test_random_bytes_are_refused_or_come_back(data: st.DataObject) -> None:
    layout = LAYOUTS[data.draw(st.sampled_from(sorted(LAYOUTS)))]
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    packets = rng.integers(0, 256, (data.draw(st.integers(0, 3)), layout.packet_bytes), np.uint8)
    if data.draw(st.booleans()):
        _write_constants(layout, packets)
    fits = layout.fits(packets)
    assert [layout.takes(packet.tobytes()) for packet in packets] == fits.tolist()
    assert np.array_equal(layout.join(layout.split(packets[fits])), packets[fits])


@given(st.data())
@settings(deadline=None, max_examples=examples(200))
def test_a_changed_byte_is_kept_or_makes_the_packet_unfit(data: st.DataObject) -> None:
    layout = LAYOUTS[data.draw(st.sampled_from(sorted(LAYOUTS)))]
    packets = np.random.default_rng(5).integers(0, 256, (2, layout.packet_bytes), np.uint8)
    _write_constants(layout, packets)
    assert layout.fits(packets).all()
    packets[0, data.draw(st.integers(0, layout.packet_bytes - 1))] ^= data.draw(st.integers(1, 255))
    fits = layout.fits(packets)
    assert fits[1]
    assert [layout.takes(packet.tobytes()) for packet in packets] == fits.tolist()
    assert np.array_equal(layout.join(layout.split(packets[fits])), packets[fits])


@given(st.binary(max_size=1400))
@settings(deadline=None)
def test_a_payload_of_any_bytes_has_no_layout_or_one_that_fits(payload: bytes) -> None:
    for sensor in SENSORS.values():
        layout = sensor.layout_of(payload)
        assert (layout is None) == (sensor.evidence(payload) is None)
        assert layout is None or layout.packet_bytes == len(payload)


def test_no_packet_is_taken_by_two_layouts() -> None:
    """Of layouts of one size, that is: a packet of one size is no packet of another."""
    for name, layout in LAYOUTS.items():
        packets = np.random.default_rng(7).integers(0, 256, (1, layout.packet_bytes), np.uint8)
        _write_constants(layout, packets)
        takers = [key for key, other in LAYOUTS.items() if other.packet_bytes == layout.packet_bytes]
        assert [key for key in takers if LAYOUTS[key].fits(packets)[0]] == [name]


@pytest.mark.parametrize("name", LAYOUTS)
def test_planes_and_series_have_the_types_that_the_layout_says(name: str) -> None:
    layout = LAYOUTS[name]
    packets = np.random.default_rng(9).integers(0, 256, (3, layout.packet_bytes), np.uint8)
    _write_constants(layout, packets)
    images = layout.split(packets)
    assert layout.planes[0].name == "range"
    assert {plane.name: plane.dtype for plane in layout.planes} == {
        key: plane.dtype for key, plane in images.planes.items()
    }
    assert {key: (values.dtype, len(values) // 3) for key, values in images.series.items()} == layout.series
    bits = sum(plane.size * plane.itemsize for plane in (*images.planes.values(), *images.series.values()))
    constant = packets.size - bits
    assert 0 <= constant <= 3 * 26, "every byte is in a plane, in a series or in a constant"


def _without(images: Images, name: str) -> Images:
    return replace(images, series={key: values for key, values in images.series.items() if key != name})


def _with(images: Images, name: str, values: np.ndarray) -> Images:
    if name in images.planes:
        return replace(images, planes=images.planes | {name: values})
    return replace(images, series=images.series | {name: values})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda images: _without(images, "time_us"), "are not of the layout single"),
        (lambda images: _with(images, "range3", images.planes["range"]), "are not of the layout single"),
        (lambda images: _with(images, "range", images.planes["range"][:15]), "16 x 24 n"),
        (lambda images: _with(images, "range", images.planes["range"][:, :-1]), "16 x 24 n"),
        (lambda images: _with(images, "range", images.planes["range"].ravel()), "16 x 24 n"),
        (lambda images: _with(images, "intensity", images.planes["intensity"][:, :-24]), "plane intensity"),
        (lambda images: _with(images, "intensity", images.planes["range"] | np.uint16(256)), "intensity holds"),
        (lambda images: _with(images, "range", images.planes["range"].astype(np.int32)), "unsigned"),
        (lambda images: _with(images, "time_us", images.series["time_us"][:-1]), "series time_us"),
        (lambda images: _with(images, "azimuth", np.full(24, 65536, np.uint32)), "azimuth holds 65536"),
        (lambda images: _with(images, "mode", np.full(2, 0x39, np.uint8)), "mode"),
    ],
)
def test_images_that_do_not_fit_together_are_refused(change, message: str) -> None:
    layout = LAYOUTS["vlp16 single"]
    packets = np.random.default_rng(11).integers(0, 256, (2, layout.packet_bytes), np.uint8)
    _write_constants(layout, packets)
    images = layout.split(packets)
    assert np.array_equal(layout.join(images), packets)
    with pytest.raises(SectionError, match=message):
        layout.join(change(images))


def test_a_layout_of_another_kind_of_packets_is_refused() -> None:
    sensor = SENSORS["vlp16"]
    images = sensor.layouts[0].split(np.zeros((0, 1206), np.uint8))

    class Other:
        name = "columns"

    with pytest.raises(SectionError, match="columns is not one of packets made of blocks"):
        sensor.azimuth(Other(), images)


@pytest.mark.parametrize("name", SENSORS)
def test_no_packets_give_empty_images(name: str) -> None:
    sensor = SENSORS[name]
    for layout in sensor.layouts:
        images = layout.split(np.zeros((0, layout.packet_bytes), np.uint8))
        assert layout.join(images).shape == (0, layout.packet_bytes)
        assert sensor.azimuth(layout, images).shape == (0,)
        assert sensor.times_ns(layout, images).shape[1] == 0
        assert sensor.points(sensor.generic_sensor, layout, images)[0].shape == (layout.rows, 0)


def _write_constants(layout, packets: np.ndarray) -> None:
    records = packets.view(layout.packet)[:, 0]
    for name, values in layout.constants.items():
        if name == "blocks.flag":
            records["blocks"]["flag"] = values
        else:
            records[name] = values[0]
    for name, values in layout.modes.items():
        records[name] = values[0]
