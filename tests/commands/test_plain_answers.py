"""What somebody loses if these fail: a minute over what a folder holds, what an IMU sends, or how a link is set."""

from __future__ import annotations

import re

import pytest

import lidarcodec
from lidarcodec.cli import app
from lidarcodec.commands.running.options import command_line
from lidarcodec.commands.unkept import positions_text
from lidarcodec.sensors.models.table import aside_name
from tests.command_line import run_here, the_one_line


def test_a_folder_says_what_is_in_it_and_how_to_get_the_other(tmp_path):
    """`decode` makes KITTI's files and `convert` a rosbag of a name without an ending, and neither said so."""
    recording = tmp_path / "a.mcap"
    assert run_here("encode", "sim:road?sensor=vlp16", recording, "--frames", 1).returncode == 0
    decoded = run_here("decode", recording, tmp_path / "scans").stdout
    assert "(kitti; `convert` makes a rosbag2 of a folder" in decoded
    converted = run_here("convert", recording, tmp_path / "bag").stdout
    assert "a rosbag2 (files of points: --as kitti, --as ply)" in converted
    chosen = run_here("decode", recording, tmp_path / "ply", "--as", "ply").stdout
    assert "rosbag2" not in chosen
    packets = run_here("decode", recording, tmp_path / "back.pcap").stdout
    assert re.search(r"back.pcap: 1 frame, \d+ packets, [\d,]+ points", packets)
    other = run_here("decode", tmp_path / "back.pcap", tmp_path / "x.pcap")
    told = "back.pcap is not a recording (.mcap): `lidarcodec convert` takes captures and other sources"
    assert told in the_one_line(other)


def test_packets_beside_the_data_have_the_name_of_what_sends_them(tmp_path):
    assert (aside_name("os1-128"), aside_name("vlp16")) == ("IMU packet", "position packet")
    assert (
        positions_text(tmp_path / "a.ply", 1, "os1-128") == ", 1 IMU packet left out (.pcap and recordings hold them)"
    )
    assert positions_text(tmp_path / "a.pcap", 30, "hdl64e") == ", 30 position packets"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--link", "1mbit"), "--codec auto --set target_kbps=800"),
        (("--link=5mbit",), "--codec auto --set target_kbps=4000"),
        (("--link", "lan"), "here it is --codec auto (see"),
        (("--link", "7mbit"), "--set target_kbps=VALUE"),
    ],
)
def test_a_link_is_answered_with_the_settings_of_a_file(tmp_path, words, said):
    done = run_here("encode", "sim:road", tmp_path / "a.mcap", *words)
    assert done.returncode == 2
    assert said in done.stderr


def test_the_version_is_told_without_making_any_command():
    """It took half as long again, for the options of forty commands that nobody had asked for."""
    assert command_line(app, ["--version"]).commands == {}
    assert command_line(app, ["--help"]).commands
    assert run_here("--version").stdout == f"{lidarcodec.__version__}\n"
