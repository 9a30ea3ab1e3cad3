"""What a user would lose here: bits of unusual packets of an Ouster, or an answer to damaged images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcodec.errors import SectionError
from lidarcodec.sensors.images import MAX_PLANES, Images
from lidarcodec.sensors.models.ouster.bare import layout_of, layouts_of_size
from lidarcodec.sensors.models.ouster.sensor import bare_sensor_of, bare_sensors
from tests.sensors.ouster_packets import LAYOUTS, likely_packets, random_packets
from tests.sweeps import examples

BOTH_HEADS = {
    **LAYOUTS,
    "RNG15_RFL8_NIR8 32 fusa": replace(LAYOUTS["RNG15_RFL8_NIR8 32"], fusa_head=True),
    "FUSA_RNG15_RFL8_NIR8_DUAL 16 standard": replace(LAYOUTS["FUSA_RNG15_RFL8_NIR8_DUAL 16"], fusa_head=False),
    "RNG15_RFL8_NIR8 16 columns 4": replace(LAYOUTS["RNG15_RFL8_NIR8 16"], columns=4),
    "LEGACY 16 columns 1": replace(LAYOUTS["LEGACY 16"], columns=1),
}


@given(st.sampled_from(sorted(BOTH_HEADS)), st.integers(0, 2**32), st.integers(0, 3), st.booleans())
@settings(deadline=None, max_examples=examples(60))
def test_random_bytes_are_refused_or_come_back(name: str, seed: int, count: int, named: bool) -> None:
    layout = BOTH_HEADS[name]
    packets = np.random.default_rng(seed).integers(0, 256, (count, layout.packet_bytes), np.uint8)
    if named:
        packets = random_packets(layout, count, seed)
    fits = layout.fits(packets)
    assert fits.shape == (count,)
    assert fits.all() or not named
    assert np.array_equal(layout.join(layout.split(packets[fits])), packets[fits])


@given(st.sampled_from(sorted(BOTH_HEADS)), st.data())
@settings(deadline=None, max_examples=examples(100))
def test_a_changed_byte_is_kept_or_makes_the_packet_unfit(name: str, data: st.DataObject) -> None:
    layout = BOTH_HEADS[name]
    packets = random_packets(layout, 2, seed=5)
    packets[0, data.draw(st.integers(0, layout.packet_bytes - 1))] ^= data.draw(st.integers(1, 255))
    fits = layout.fits(packets)
    assert fits[1]
    assert np.array_equal(layout.join(layout.split(packets[fits])), packets[fits])


@pytest.mark.parametrize("name", BOTH_HEADS)
def test_planes_are_as_the_layout_says(name: str) -> None:
    layout = BOTH_HEADS[name]
    images = layout.split(random_packets(layout, 2))
    assert [plane.name for plane in layout.planes] == list(images.planes)
    assert len(images.planes) <= MAX_PLANES
    assert (layout.planes[0].name, layout.planes[0].role) == ("range", "range")
    for plane in layout.planes:
        values = images.planes[plane.name]
        assert (values.dtype, values.shape) == (plane.dtype, (layout.rows, 2 * layout.columns))
        assert int(values.max()).bit_length() <= plane.bits <= 20
        assert values.flags.c_contiguous
        assert plane.of in images.planes
    for series, (dtype, each) in layout.series.items():
        assert (images.series[series].dtype, len(images.series[series])) == (dtype, 2 * each)


def test_a_view_of_packets_is_split_as_a_copy() -> None:
    layout = LAYOUTS["RNG19_RFL8_SIG16_NIR16 16"]
    packets = random_packets(layout, 6)
    images = layout.split(packets[::2])
    assert layout.fits(packets[::2]).all()
    assert np.array_equal(layout.join(images), packets[::2])


def test_images_that_do_not_fit_together_are_refused() -> None:
    layout = LAYOUTS["RNG15_RFL8_NIR8 16"]
    images = layout.split(random_packets(layout, 2))
    planes, series = images.planes, images.series
    for changed, message in (
        (Images(planes, {**series, "frame_id": series["frame_id"][:1]}), r"series frame_id is \(1,\), but 2 packets"),
        (
            Images(planes, {**series, "init_id": np.full(2, 1 << 24, np.uint32)}),
            "holds 16777216: its field has 24 bits",
        ),
        (Images(planes, {**series, "status": series["status"].astype(np.int32)}), "instead of unsigned integers"),
        (Images(planes, {**series, "more": series["status"]}), "are not of the layout rng15_rfl8_nir8"),
        (Images({**planes, "range": planes["range"][:, :9]}, series), r"are 16 x 16 n, not \(16, 9\)"),
        (Images({**planes, "flags": planes["flags"][:8]}, series), r"plane flags is \(8, 32\), but range is"),
        (Images({**planes, "range": planes["range"] | 0x8000}, series), "plane range holds .* its field has 15 bits"),
    ):
        with pytest.raises(SectionError, match=message):
            layout.join(changed)


@pytest.mark.parametrize("name", LAYOUTS)
def test_packets_alone_show_their_layout(name: str) -> None:
    layout = LAYOUTS[name]
    for packet in likely_packets(layout, 4):
        sensor = bare_sensor_of(packet.tobytes())
        assert sensor is not None
        assert sensor.layout == layout
        assert sensor.range_step_m == (0.008 if "RNG15" in layout.profile else 0.001)
        assert sensor.evidence(packet.tobytes()).startswith(f"{len(packet)} bytes, 16 columns of {layout.rows} pixels")
        assert bare_sensors()[sensor.name] is sensor


def test_sizes_that_several_layouts_share_are_known() -> None:
    shared = {size: len(layouts_of_size(size)) for size in (2304, 4352, 8448, 16640)}
    assert shared == {2304: 2, 4352: 3, 8448: 3, 16640: 2}
    assert layouts_of_size(48) == ()


@pytest.mark.parametrize("name", LAYOUTS)
def test_packets_of_other_sensors_are_not_taken(name: str) -> None:
    layout = LAYOUTS[name]
    rng = np.random.default_rng(3)
    for _ in range(10):
        assert layout_of(rng.integers(0, 256, layout.packet_bytes, np.uint8).tobytes()) is None
    packet = likely_packets(layout, 1)[0]
    start = 0 if layout.legacy else 32
    for at in (start + 8, start + layout.column_bytes + 9, start + 7):  # ids that jump, a time far from the others
        changed = packet.copy()
        changed[at] ^= 0x55
        assert layout_of(changed.tobytes()) is None


@given(st.binary(max_size=1300))
@settings(deadline=None)
def test_a_payload_of_any_bytes_has_no_layout_or_one_that_fits(payload: bytes) -> None:
    layout = layout_of(payload)
    assert layout is None or layout.packet_bytes == len(payload)


@pytest.mark.parametrize("name", [name for name in LAYOUTS if LAYOUTS[name].packet_bytes in (2304, 4352, 8448, 16640)])
@pytest.mark.parametrize(
    "empty",
    [
        {"range", "intensity", "range2", "intensity2", "flags", "flags2", "window"},  # the sky
        {"near_ir", "window"},  # the night
        {"range2", "intensity2", "signal2", "flags", "flags2", "near_ir"},  # one return, the night, a full window
    ],
)
def test_a_layout_is_seen_by_day_and_by_night(name: str, empty: set[str]) -> None:
    layout = LAYOUTS[name]
    images = layout.split(likely_packets(layout, 1))
    planes = {plane: np.zeros_like(values) if plane in empty else values for plane, values in images.planes.items()}
    if "window" in planes and "window" not in empty:
        planes["window"] = np.full_like(planes["window"], 255)
    assert layout_of(layout.join(Images(planes, images.series)).tobytes()) == layout


def test_packets_in_the_dark_have_a_layout() -> None:
    """Without any return or light, one of those of its size; the next packets decide."""
    for size in (2304, 4352, 8448, 16640):
        for layout in layouts_of_size(size):
            dark = likely_packets(layout, 1)
            images = layout.split(dark)
            empty = {plane: np.zeros_like(values) for plane, values in images.planes.items()}
            found = layout_of(layout.join(Images(empty, images.series)).tobytes())
            assert found in layouts_of_size(size)
            assert found.fusa_head == layout.fusa_head
