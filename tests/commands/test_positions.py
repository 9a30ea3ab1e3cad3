"""Position packets through every command: kept, counted, compared, and what has no place for them says so."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lidarcodec.packet import Packet, data_packets
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from tests.command_line import run, run_here
from tests.packets import packets_in, turning
from tests.positions import interleaved, position

SENT = [*interleaved(turning(700), every=9, first=0), position(turning(700)[-1].stamp_ns + 7000)]
COUNT = sum(packet.position for packet in SENT)


def written(path: Path, packets: list[Packet]) -> Path:
    with path.open("wb") as file:
        PcapWriter(file).write_all(packets)
    return path


@pytest.fixture
def capture(tmp_path):
    return written(tmp_path / "drive.pcap", SENT)


def test_encode_and_decode_give_the_same_capture(tmp_path, capture):
    recording, back = tmp_path / "drive.mcap", tmp_path / "back.pcap"
    done = run("encode", capture, recording, "--set", "max_error_m=0")
    assert done.returncode == 0
    assert "not kept" not in done.stderr
    assert f"{COUNT} position packets" in run_here("decode", recording, back).stdout
    assert packets_in(back) == SENT
    assert packets_in(recording) == SENT
    said = run_here("decode", recording, tmp_path / "back.npz").stdout
    assert "left out (.pcap and recordings hold them)" in said


@pytest.mark.parametrize(("name", "words"), [("a.pcap", ()), ("a.mcap", ()), ("a.mcap", ("--as", "packets"))])
def test_convert_keeps_them(tmp_path, capture, name, words):
    out = tmp_path / name
    done = run("convert", capture, out, *words, *(("--set", "max_error_m=0") if name == "a.mcap" and not words else ()))
    assert done.returncode == 0, done.stderr
    frames = "3 frames" if name == "a.mcap" and not words else "700 packets, 3 frames"
    assert f"{frames}, {COUNT} position packets" in done.stdout
    assert packets_in(out) == SENT
    assert "not kept" not in done.stderr


def test_frames_and_skip_count_turns_of_data_packets(tmp_path, capture):
    out = tmp_path / "part.pcap"
    assert "333 packets, 1 frame" in run_here("convert", capture, out, "--skip", "1", "--frames", "1").stdout
    sent = list(data_packets(packets_in(out)))
    begin = turning(700).index(sent[0])
    assert begin in (333, 334)
    assert sent == turning(700)[begin : begin + 333]


def test_a_rosbag_says_that_it_has_no_place_for_them(tmp_path, capture):
    done = run("convert", capture, tmp_path / "bag")
    assert done.returncode == 0
    assert f"position packets: {COUNT} were left out" in done.stderr
    assert packets_in(tmp_path / "bag") == turning(700)


def test_verify_compares_them_and_says_so(tmp_path, capture):
    recording = tmp_path / "drive.mcap"
    run_here("encode", capture, recording, "--set", "max_error_m=0")
    done = run_here("verify", recording, capture)
    assert done.returncode == 0
    assert f"position packets {COUNT}, identical" in done.stdout
    plain = tmp_path / "plain.mcap"
    assert f"not kept: {COUNT} position packets" in run("encode", f"{capture}?position=off", plain).stderr
    done = run_here("verify", plain, capture)
    assert done.returncode == 1
    assert f"BROKEN           {COUNT} position packets of the source are missing" in done.stdout
    found = json.loads(run_here("verify", recording, written(tmp_path / "none.pcap", turning(700)), "--json").stdout)
    assert found["position_packets"] == COUNT
    assert found["identical_position_packets"] == 0
    assert f"{COUNT} position packets differ from those of the source" in found["broken"]


@pytest.mark.parametrize("words", [("--frames", "1"), ("--skip", "1"), ("--skip", "1", "--frames", "1")])
def test_verify_of_a_part_asks_for_its_own_only(tmp_path, capture, words):
    recording = tmp_path / "part.mcap"
    run_here("encode", capture, recording, "--set", "max_error_m=0", "--set", "framing=packets:100", *words)
    found = json.loads(run_here("verify", recording, capture, "--json").stdout)
    assert found["position_packets_identical"]
    assert found["position_packets"] >= 11


def test_a_wrong_byte_or_place_is_found(tmp_path, capture):
    recording = tmp_path / "drive.mcap"
    run_here("encode", capture, recording, "--set", "max_error_m=0")
    at = [number for number, packet in enumerate(SENT) if packet.position][30]
    wrong = SENT[at]._replace(payload=SENT[at].payload[:-1] + b"x")
    moved = [*SENT[:at], SENT[at + 1], SENT[at], *SENT[at + 2 :]]
    for number, packets in enumerate(([*SENT[:at], wrong, *SENT[at + 1 :]], moved)):
        done = run_here("verify", recording, written(tmp_path / f"{number}.pcap", packets))
        assert done.returncode == 1
        assert "1 position packets differ from those of the source" in done.stdout


def test_info_counts_them(tmp_path, capture):
    recording = tmp_path / "drive.mcap"
    run_here("encode", capture, recording)
    for what in (capture, recording, f"{recording}?read=messages"):
        found = json.loads(run_here("info", what, "--json").stdout)
        assert found["position packets"] == COUNT
        assert "position packets" not in found["noticed"]
    assert json.loads(run_here("info", capture, "--json").stdout)["packets"] == 700


def test_bench_measures_data_packets(capture):
    (found,) = json.loads(run_here("bench", capture, "--codec", "pcodec", "--set", "max_error_m=0", "--json").stdout)
    assert found["packets_identical"]
