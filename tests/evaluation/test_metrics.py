"""The figures that codecs are chosen by: an error here and every table of ours is wrong."""

import math

import numpy as np
import pytest

from lidarcodec import api
from lidarcodec.evaluation.metrics import RangeErrors, Sizes, times_ms
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import size_of


def image(*values):
    return np.array([values], np.uint16)


def test_errors_are_taken_only_where_both_have_a_return():
    errors = RangeErrors()
    errors.add(image(1000, 1000, 0, 1000, 0), image(1003, 996, 5000, 0, 0))
    assert (errors.points, errors.lost, errors.invented) == (3, 1, 1)
    assert errors.max_error_m == pytest.approx(0.008)
    assert errors.rmse_m == pytest.approx(0.002 * math.sqrt((9 + 16) / 2))
    assert errors.psnr_db == pytest.approx(20 * math.log10(130 / errors.rmse_m))


def test_psnr_is_none_without_an_error_and_all_are_none_without_a_return():
    errors = RangeErrors()
    errors.add(image(7, 0), image(7, 0))
    assert (errors.rmse_m, errors.psnr_db, errors.max_error_m) == (0, None, 0)
    empty = RangeErrors()
    empty.add(image(0, 0), image(0, 9))
    assert (empty.rmse_m, empty.psnr_db, empty.max_error_m, empty.invented) == (None, None, None, 1)


def test_the_full_range_of_the_sensor_does_not_overflow():
    errors = RangeErrors()
    errors.add(np.full((64, 2088), 65535, np.uint16), np.full((64, 2088), 1, np.uint16))
    assert errors.max_error_m == pytest.approx(65534 * 0.002)
    assert errors.rmse_m == pytest.approx(65534 * 0.002)


def test_frames_of_different_widths_add_up():
    errors = RangeErrors()
    errors.add(image(10, 20), image(11, 20))
    errors.add(image(10, 20, 30), image(10, 21, 30))
    assert errors.points == 5
    assert errors.rmse_m == pytest.approx(0.002 * math.sqrt(2 / 5))


def message(*sections):
    return Message(
        codec=1, stream_id=1, frame_index=0, stamp_ns=0, key=True, width=6, packets=1, sections=tuple(sections)
    )


def test_every_bit_of_a_message_is_in_exactly_one_part():
    sizes = Sizes()
    planes = [SectionType.RANGE, SectionType.MASK, SectionType.INTENSITY, SectionType.AZIMUTH, SectionType.SIDE]
    sections = [Section(kind, bytes(10 * (at + 1))) for at, kind in enumerate(planes)]
    sizes.add(message(*sections, Section(SectionType.CALIBRATION, bytes(100)), Section(200, bytes(7))), total=400)
    bits = sizes.bits_per(8)
    assert bits["geometry"] == bits["range"] + bits["mask"] == 10 + 20
    assert bits["total"] == 400
    assert bits["total"] == sum(bits[part] for part in ("geometry", "intensity", "azimuth", "side", "header"))
    assert bits["header"] == 400 - 150


def test_keep_counts_as_geometry():
    sizes = Sizes()
    sizes.add(message(Section(SectionType.RANGE, bytes(5)), Section(SectionType.KEEP, bytes(3))), total=100)
    bits = sizes.bits_per(8)
    assert (bits["range"], bits["mask"], bits["geometry"]) == (5, 0, 8)


def test_without_a_point_there_are_no_bits_per_point():
    assert set(Sizes(total=9).bits_per(0).values()) == {None}


def test_times_are_in_milliseconds():
    assert times_ms([0.001, 0.003]) == {"mean": 2.0, "p50": 2.0, "p99": 2.98}
    assert times_ms([]) == {"mean": None, "p50": None, "p99": None}


@pytest.mark.parametrize("codec", ["raw", "pcodec", "predictive", "riddle"])
def test_bits_of_another_sensor_are_those_of_its_planes(codec):
    """A bench that says `range 0.00` of a sensor whose ranges take two thirds of the bits misleads."""
    frame = list(api.read_frames("sim:street?sensor=vlp16&frames=2"))[1]
    (message,) = StreamEncoder(StreamSettings(codec=codec)).encode(frame)
    sizes = Sizes()
    sizes.add(message, size_of(message))
    bits = sizes.bits_per(frame.points)
    assert "planes" not in bits
    assert bits["range"] > bits["intensity"] > 0.5
    assert bits["total"] == pytest.approx(
        sum(bits[part] for part in ("geometry", "intensity", "azimuth", "side", "header")), abs=1e-4
    )


def test_images_in_one_stream_are_not_split():
    frame = list(api.read_frames("sim:street?sensor=vlp16&frames=2"))[1]
    (message,) = StreamEncoder(StreamSettings(codec="zstd")).encode(frame)
    sizes = Sizes()
    sizes.add(message, size_of(message))
    bits = sizes.bits_per(frame.points)
    assert bits["range"] is bits["mask"] is bits["geometry"] is bits["intensity"] is None
    assert bits["planes"] > 1
