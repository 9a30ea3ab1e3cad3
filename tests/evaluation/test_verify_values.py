"""If these fail, `verify` passes recordings whose second returns, intensities or points are not the source's."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from lidarcodec.evaluation.verdict import broken_promises
from lidarcodec.evaluation.verify import Comparison, PacketsByTime, promise_of
from lidarcodec.frame_images import images_of, layout_of
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.sensors.clouds.grid import GridFinder, grid_of
from lidarcodec.sensors.clouds.message import read_message
from lidarcodec.sensors.clouds.sensor import cloud_sensor
from lidarcodec.settings import StreamSettings
from tests.packets import sensor, turning
from tests.point_clouds import STAMP_NS, message, velodyne
from tests.sensors.made_frames import block_sensor, packets_of_model

LOSSY = {"max_error_m": 0.05}
RINGS = velodyne(90)


def compared(packets, source, model, **settings):
    """What `verify` says of a recording of some packets, and its report, if its source has others of the same times."""
    encoder, decoder = StreamEncoder(StreamSettings(**settings)), StreamDecoder()
    encoder.prepare(model)
    found, by_time = Comparison(), PacketsByTime(source)
    for frame in frames_of(packets, model, encoder.settings.framing):
        for one in encoder.encode(frame):
            for decoded in decoder.decode(one):
                found.add(decoded, by_time, promise_of(one))
    found.finish(by_time)
    return broken_promises(encoder.settings, found), found.result()


def changed(packets, model, name, by):
    """The same packets with other numbers in a plane."""
    (frame,) = frames_of(packets, model, "packets:2048")
    _, layout = layout_of(frame)
    images = images_of(frame, layout)
    plane = images.planes[name]
    images.planes[name] = np.where(plane > 0, plane + by, 0).astype(plane.dtype)
    joined = layout.join(images)
    return [Packet(row.tobytes(), packet.stamp_ns) for row, packet in zip(joined, packets, strict=True)]


@pytest.mark.parametrize("more", [{}, {"reduction": "columns:2"}, {"reduction": "lattice:2"}, {"intensity": "off"}])
@pytest.mark.parametrize("codec", ["zstd", "predictive", "riddle"])
def test_a_lossy_recording_of_two_returns_is_as_promised(codec, more):
    model = block_sensor("vlp16")
    packets = packets_of_model(model, "dual", 24)
    assert compared(packets, packets, model, codec=codec, **LOSSY, **more)[0] == []


@pytest.mark.parametrize("more", [{}, {"reduction": "columns:2"}, {"reduction": "lattice:2"}])
@pytest.mark.parametrize(
    ("name", "by", "says"),
    [
        ("range2", 40, "larger errors of range2"),
        ("intensity", 1, "other values of intensity"),
        ("intensity2", 1, "other values of intensity2"),
    ],
)
def test_planes_that_are_not_those_of_the_source_are_broken(name, by, says, more):
    model = block_sensor("vlp16")
    packets = packets_of_model(model, "dual", 24)
    source = changed(packets, model, name, by)
    (text,) = compared(packets, source, model, codec="zstd", **LOSSY, **more)[0]
    assert says in text


def test_intensities_of_an_hdl64e_that_are_not_those_of_the_source_are_broken():
    packets = turning(24)
    wrong = bytearray(packets[5].payload)
    wrong[6] ^= 1
    source = [*packets[:5], Packet(bytes(wrong), packets[5].stamp_ns), *packets[6:]]
    assert compared(packets, packets, sensor(), **LOSSY)[0] == []
    assert compared(packets, source, sensor(), **LOSSY)[0] == ["1 frames have other values of intensity"]
    assert compared(packets, source, sensor(), intensity="levels=4", **LOSSY)[0] == []


def cloud(points, **more):
    return [Packet(message(points, **more), STAMP_NS)]


@pytest.mark.parametrize("bound_m", [0.0005, 0.02, 0.3])
def test_points_of_a_cloud_may_be_off_by_the_whole_bound(bound_m):
    """Ranges of the image are rounded to steps of a millimetre, so the points are compared themselves."""
    packets = cloud(RINGS)
    model = cloud_sensor([packets[0].payload])
    broken, report = compared(packets, packets, model, codec="pcodec", max_error_m=bound_m)
    assert broken == []
    assert 0.008 * bound_m < report["max_error_m"] <= bound_m
    assert report["bounds_m"] == [round(bound_m, 3) if bound_m >= 0.001 else 0.0]
    json.dumps(report, allow_nan=False)


def turned():
    points = RINGS.copy()
    points["x"], points["y"] = -RINGS["y"], RINGS["x"]
    return points


def field_of(name, value):
    points = RINGS.copy()
    points[name] = value
    return points


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (turned(), "larger errors than their messages allow"),
        (field_of("intensity", 7), "other fields"),
        (field_of("time", 0), "other fields"),
        (np.concatenate((RINGS[1:], RINGS[:1])), "other fields"),
    ],
)
def test_a_cloud_that_is_not_that_of_the_source_is_broken(points, says):
    packets = cloud(RINGS)
    model = cloud_sensor([packets[0].payload])
    broken, report = compared(packets, cloud(points), model, codec="zstd", max_error_m=0.02)
    assert any(says in text for text in broken), broken
    json.dumps(report, allow_nan=False)


def test_coordinates_that_are_no_numbers_count_as_other_ones():
    points = RINGS.copy()
    points["x"][3] = np.nan
    packets = cloud(points)
    model = cloud_sensor([packets[0].payload])
    assert compared(packets, packets, model, codec="zstd", max_error_m=0.02)[0] == []
    broken, report = compared(packets, cloud(RINGS), model, codec="zstd", max_error_m=0.02)
    assert any("other fields" in text for text in broken)
    assert replace(Comparison(), frames=1).result()["max_error_m"] is None
    json.dumps(report, allow_nan=False)


@pytest.mark.parametrize("bound_m", [None, 0.02])
def test_messages_of_a_stream_are_compared_though_their_images_depend_on_those_before(bound_m):
    """A turn that begins with another firing has a column more than it has by itself."""
    turns = [RINGS, np.roll(RINGS, 1), np.roll(RINGS, 9)]
    packets = [Packet(message(points), STAMP_NS + number * 10**8) for number, points in enumerate(turns)]
    model = cloud_sensor([packets[0].payload])
    finder = GridFinder()
    widths = [(finder.find(one), grid_of(one)) for one in (read_message(packet.payload) for packet in packets)]
    assert any(one.columns != other.columns for one, other in widths)
    broken, report = compared(packets, packets, model, codec="pcodec", max_error_m=bound_m)
    assert broken == []
    assert (report["points"], report["lost"], report["invented"]) == (3 * np.count_nonzero(returned(RINGS)), 0, 0)


def returned(points):
    return read_message(message(points)).returns
