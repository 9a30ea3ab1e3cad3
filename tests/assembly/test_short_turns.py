"""What somebody loses if these fail: the word that half of a turn never came, or the trust in it."""

from __future__ import annotations

import json
from functools import cache

import pytest

from lidarcodec.assembly.short_turns import ShortTurns
from lidarcodec.packet import Packet
from lidarcodec.pipeline import frames_of
from lidarcodec.sources import open_source
from tests.command_line import run_here

SENSORS = {
    "hdl64e": "sim:road?frames=5",
    "vlp16": "sim:road?sensor=vlp16&frames=5",
    "os1": "sim:road?sensor=os1-32&frames=5",
}


@cache
def packets_of(name):
    with open_source(SENSORS[name]) as source:
        return source.sensor, tuple(source.packets())


def seen(name, packets):
    sensor, _ = packets_of(name)
    found = ShortTurns()
    for frame in frames_of(packets, sensor):
        found.add(frame)
    return found


@pytest.mark.parametrize("name", SENSORS)
def test_packets_that_are_missing_within_a_turn_are_counted_to_the_column(name):
    """Half of the turns of a capture lacked more than half of their columns, and `info` was silent."""
    sensor, packets = packets_of(name)
    assert not seen(name, packets).rows()
    at, gone = len(packets) * 3 // 10, len(packets) // 20
    widths = [frame.width for frame in frames_of(packets, sensor)]
    left = [*packets[:at], *packets[at + gone :]]
    rows = seen(name, left).rows()
    lacking = sum(widths) - sum(frame.width for frame in frames_of(left, sensor))
    assert [row.turn for row in rows] == [1]
    assert len(rows[0].gaps) == 1
    assert sum(row.missing for row in rows) == pytest.approx(lacking, abs=1)
    assert rows[0].columns + rows[0].missing == pytest.approx(widths[1], abs=1)


@pytest.mark.parametrize("name", SENSORS)
def test_a_gap_over_the_end_of_a_turn_is_shared_between_both(name):
    sensor, packets = packets_of(name)
    widths = [frame.width for frame in frames_of(packets, sensor)]
    each, gone = len(packets) / len(widths), len(packets) // 40
    at = int(2 * each)
    rows = seen(name, [*packets[: at - gone], *packets[at + gone :]]).rows()
    assert [row.turn for row in rows] == [1, 2]
    assert all(row.columns > widths[row.turn] // 2 for row in rows)
    assert sum(row.missing for row in rows) == pytest.approx(2 * gone * sum(widths) / len(packets), rel=0.02)


@pytest.mark.parametrize("name", SENSORS)
def test_a_whole_turn_that_is_missing_is_told_by_the_clocks(name):
    _, packets = packets_of(name)
    each = len(packets) // 5
    sensor, _ = packets_of(name)
    left = [*packets[: 2 * each], *packets[3 * each :]]
    (row,) = seen(name, left).rows()
    assert row.turns_before == 1
    assert row.columns == [frame.width for frame in frames_of(left, sensor)][row.turn]


@pytest.mark.parametrize("name", SENSORS)
def test_packets_that_came_twice_or_in_another_order_are_no_loss(name):
    _, packets = packets_of(name)
    twice = [packet for packet in packets for _ in (0, 1)]
    swapped = list(packets)
    for at in range(20, len(swapped) - 20, 7):
        swapped[at], swapped[at + 1] = (
            Packet(swapped[at + 1].payload, swapped[at].stamp_ns),
            Packet(swapped[at].payload, swapped[at + 1].stamp_ns),
        )
    assert not seen(name, twice).rows()
    assert not [row for row in seen(name, swapped).rows() if row.turns_before or row.missing > 60]


def test_a_part_that_the_sensor_is_set_not_to_send_is_no_loss(data_file):
    """Half of each turn: field of view from 270 to 90 degrees."""
    found = json.loads(run_here("info", data_file("sensors/velodyne/vlp32.pcap.xz"), "--json").stdout)
    assert found["not_sent"] == "90.95 to 270.17 degrees of each turn"
    assert "short_turns" not in found
    assert not found["noticed"]


def test_info_encode_and_verify_say_which_turns_are_short(data_file, tmp_path, caplog):
    capture, out = data_file("sensors/hesai/pandar_xt32m.pcap.xz"), tmp_path / "out.mcap"
    found = json.loads(run_here("info", capture, "--json").stdout)
    assert [(row["turn"], row["columns"], row["missing"]) for row in found["short_turns"]] == [
        (1, 759, 1239), (2, 1869, 132), (3, 816, 1185)
    ]  # fmt: skip
    assert found["noticed"] == {"turns that lack columns": 3, "missing columns": 2556}
    made = run_here("encode", capture, out, "--set", "codec=zstd")
    assert made.returncode == 0
    assert caplog.text.count("turn 1 lacks 1,239 of 1,998 (51 to 274 degrees)") == 1
    compared = run_here("verify", out, capture)
    assert compared.returncode == 0
    assert "3 of 5 turns lack columns" in compared.stdout
