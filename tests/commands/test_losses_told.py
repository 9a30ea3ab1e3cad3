"""What somebody loses if these fail: the word that three of four returns, or all intensities, were never sent."""

from __future__ import annotations

import json

import pytest

from tests.command_line import run_here

WAYS = {
    "off": ("--set", "intensity=off"),
    "bounded": ("--set", "max_error_m=0.02", "--set", "intensity=levels=8"),
    "thinned": ("--set", "reduction=columns:4"),
    "exact": (),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A capture, and recordings of it by what was lost."""
    folder = tmp_path_factory.mktemp("losses")
    capture = folder / "drive.pcap"
    assert run_here("simulate", "sim:road?sensor=vlp16", capture, "--frames", 2).returncode == 0
    for name, words in WAYS.items():
        done = run_here("encode", capture, folder / f"{name}.mcap", *words)
        assert done.returncode == 0, done.stderr
    return folder


def told(made, name):
    info = json.loads(run_here("info", made / f"{name}.mcap", "--json").stdout)["sent"]
    done = run_here("verify", made / f"{name}.mcap", made / "drive.pcap", "--json")
    assert done.returncode == 0, done.stderr
    return info, json.loads(done.stdout), run_here("verify", made / f"{name}.mcap", made / "drive.pcap").stdout


def test_intensities_that_were_not_sent_are_told(made):
    """`verify` said: largest error 0.000000, 0 lost, 0 invented."""
    info, found, text = told(made, "off")
    assert info["intensity"] == found["sent"]["intensity"] == {"not sent": 2}
    assert found["intensity_max"] > 0
    assert "not sent" in text


def test_bound_and_few_intensities_are_told(made):
    info, found, text = told(made, "bounded")
    assert info["least_bound_m"] == info["largest_bound_m"] == pytest.approx(0.02, abs=0.002)
    assert info["intensity"] == {"in few values": 2}
    assert 0 < found["intensity_mean"] < found["intensity_max"]
    assert found["max_error_m"] == info["measured"]["largest_error_m"]
    assert f"(allowed: {info['largest_bound_m']:g} m)" in text
    assert "sent with losses, as the settings allow" in text
    assert "kept             all that its messages promise" in text


def test_the_share_of_returns_is_told(made):
    info, found, _ = told(made, "thinned")
    assert found["returns_percent"] == pytest.approx(info["measured"]["returns_percent"], abs=0.1)
    assert found["returns_percent"] < 60


def test_of_an_exact_recording_all_is_there(made):
    info, found, text = told(made, "exact")
    assert (info["columns_percent"], info["measured"]["returns_percent"]) == (100, 100)
    assert found["intensity_max"] == 0
    assert "packets          " in text
    assert "identical" in text


def test_packets_of_a_thinned_recording_are_not_taken_for_the_sensors_own(made, tmp_path, caplog):
    """`decode slow.mcap slow.pcap` gave packets of which most were empty, without a word."""
    assert run_here("decode", made / "thinned.mcap", tmp_path / "back.pcap").returncode == 0
    assert "only in part: 2 frames of which not all returns were sent" in caplog.text
    caplog.clear()
    assert run_here("decode", made / "exact.mcap", tmp_path / "exact.pcap").returncode == 0
    assert "not kept" not in caplog.text
