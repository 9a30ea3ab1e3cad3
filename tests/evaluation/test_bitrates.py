"""The bitrate by which somebody chooses a link, and the exit code by which a script knows that it was kept."""

import json

import pytest

from lidarcodec.sources import open_source
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from tests.command_line import run_here

SCENE = "sim:road?frames=6&sensor=vlp16&seed=2"


def drive(path, pause_s=0):
    """A capture; its clock is set after 200 packets."""
    with open_source(SCENE) as source, path.open("wb") as file:
        writer = PcapWriter(file)
        for number, packet in enumerate(source.packets()):
            writer.write(packet._replace(stamp_ns=packet.stamp_ns + (number >= 200) * pause_s * 10**9))
    return path


def kbps(path, framing, *words):
    done = run_here("bench", path, "--codec", "zstd", "--set", f"framing={framing}", "--json", *words)
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)
    return found["kbps_at_10hz"], found["frames"]


@pytest.mark.parametrize("model", [(), ("--model", "packets")])
def test_slabs_of_another_sensor_do_not_take_a_fraction_of_the_bits_of_turns(tmp_path, model):
    """Else somebody chooses slabs for a link that they do not fit."""
    path = drive(tmp_path / "drive.pcap")
    turns, few = kbps(path, "revolution", *model)
    slabs, many = kbps(path, "packets:20", *model)
    assert many > 3 * few
    assert turns < slabs < 1.5 * turns


@pytest.mark.parametrize("pause_s", [0, 3600, -3600])
def test_a_missed_target_is_told_also_where_the_clock_stood_or_was_set(tmp_path, pause_s):
    """A recording with a pause, or a clock that was set back, is no reason to say that a target was kept."""
    done = run_here(
        "encode", drive(tmp_path / "drive.pcap", pause_s), tmp_path / "drive.mcap", "--set", "target_kbps=20"
    )
    assert done.returncode == 1, done.stderr
    assert "the target of 20 kbit/s was missed" in done.stderr
