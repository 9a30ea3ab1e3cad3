"""What somebody loses if these fail: a small recording that became three times as large, or the name of their car."""

from __future__ import annotations

import json

import pytest

from lidarcodec.recording import RecordingReader
from tests.command_line import run_here


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A recording of a car with names: four frames of an inter codec."""
    out = tmp_path_factory.mktemp("small") / "small.mcap"
    words = ("--frames", 4, "--codec", "predictive", "--vehicle", "car-7", "--sensor", "roof")
    assert run_here("encode", "sim:road?sensor=vlp16", out, *words).returncode == 0
    return out


def messages_of(path):
    with path.open("rb") as file:
        reader = RecordingReader(file)
        return [data for _, data in reader.messages()], reader.metadata, {one.topic for one in reader.channels.values()}


@pytest.mark.parametrize("command", ["encode", "convert"])
def test_without_a_setting_messages_are_kept_and_points_are_added(small, tmp_path, command):
    """`encode small.mcap big.mcap --with-clouds` coded again, and called the stream vehicle/lidar."""
    out = tmp_path / "with_points.mcap"
    done = run_here(command, small, out, "--with-clouds", "--json")
    assert done.returncode == 0, done.stderr
    before, about, _ = messages_of(small)
    after, said, topics = messages_of(out)
    assert after == before
    assert said == about
    assert any(topic.endswith("car-7/roof/points") for topic in topics)
    told = json.loads(done.stdout)
    assert (told["frames"], told["coded_bytes"]) == (4, sum(map(len, before)))
    assert "ratio" not in told


def test_a_part_begins_with_the_frame_that_it_needs_and_may_have_another_name(small, tmp_path):
    out = tmp_path / "part.mcap"
    done = run_here("encode", small, out, "--skip", 2, "--vehicle", "car-8", "--with-clouds")
    assert done.returncode == 0, done.stderr
    before, _, _ = messages_of(small)
    after, said, topics = messages_of(out)
    assert after == before
    assert "4 frames (2 of them before" in done.stdout
    assert (said["vehicle"], said["sensor"]) == ("car-8", "roof")
    assert {topic.split("/")[2] for topic in topics} == {"car-8"}


def test_with_a_setting_the_name_is_kept_and_the_ratio_is_against_what_was_there(small, tmp_path):
    out = tmp_path / "again.mcap"
    done = run_here("encode", small, out, "--codec", "zstd", "--json")
    assert done.returncode == 0, done.stderr
    before, about, _ = messages_of(small)
    after, said, _ = messages_of(out)
    told = json.loads(done.stdout)
    assert told["source_coded_bytes"] == sum(map(len, before))
    assert told["ratio"] == pytest.approx(told["source_coded_bytes"] / sum(map(len, after)))
    assert (said["vehicle"], said["sensor"]) == (about["vehicle"], about["sensor"])


def test_a_recording_of_packets_is_coded_and_keeps_its_name(small, tmp_path):
    packets, out = tmp_path / "packets.mcap", tmp_path / "coded.mcap"
    assert run_here("convert", small, packets, "--as", "packets").returncode == 0
    done = run_here("encode", packets, out)
    assert done.returncode == 0, done.stderr
    assert "bytes of packets in" in done.stdout
    assert messages_of(out)[1]["vehicle"] == "car-7"


def test_a_recording_of_two_layers_keeps_both(tmp_path):
    layered, out = tmp_path / "layered.mcap", tmp_path / "out.mcap"
    words = ("--frames", 2, "--set", "base_error_m=0.1")
    assert run_here("encode", "sim:road", layered, *words).returncode == 0
    assert run_here("encode", layered, out).returncode == 0
    sizes = [json.loads(run_here("info", path, "--json").stdout)["bytes of refinements"] for path in (layered, out)]
    assert sizes[0] == sizes[1] > 0
