"""Commands that measure a drive, or build of it, say what of the source they could not read, as `convert` does."""

from __future__ import annotations

from pathlib import Path

import pytest

from lidarcodec.api import read_frames
from lidarcodec.recording import RecordingReader, RecordingWriter
from lidarcodec.settings import StreamSettings
from tests.command_line import run_here


@pytest.fixture(scope="module")
def damaged(tmp_path_factory) -> Path:
    """A recording of ten frames with a byte that is wrong in one message, and one that needs it."""
    folder = tmp_path_factory.mktemp("damaged")
    whole, damaged = folder / "whole.mcap", folder / "damaged.mcap"
    words = ("--codec", "predictive", "--set", "key_interval=5")
    assert run_here("encode", "sim:street?frames=10", whole, *words).returncode == 0
    with whole.open("rb") as source, damaged.open("wb") as target:
        messages = [bytearray(one) for _, one in RecordingReader(source, False).messages()]
        messages[3][len(messages[3]) // 2] ^= 0xFF
        writer = RecordingWriter(target, "vehicle", "lidar", StreamSettings(), {})
        for one in messages:
            writer.write(bytes(one))
        writer.close()
    return damaged


@pytest.mark.parametrize(
    "words",
    [
        ("bench", "{}", "--codec", "zstd,pcodec"),
        ("map", "build", "{}", "-o", "x.lcmap"),
        ("evaluate", "localisation", "{}", "--protocol", "near", "--codec", "zstd"),
        ("annotate", "{}", "--out", "labels"),
    ],
    ids=" ".join,
)
def test_messages_that_cannot_be_decoded_are_named_once(damaged, tmp_path, monkeypatch, caplog, words):
    """A tenth of a drive was missing in a map, or in what was measured, without a word."""
    monkeypatch.chdir(tmp_path)
    ran = run_here(*(word.format(damaged) for word in words))
    assert ran.returncode == 0, ran.stderr
    assert caplog.text.count("could not be decoded") == 1
    assert caplog.text.count("not kept: ") == 1


def test_an_input_that_is_only_in_part_in_an_archive_is_named(damaged, tmp_path, caplog):
    """Who removed his recordings after a run that ended with 0 lost the rest: only the commits said that it lacks."""
    pytest.importorskip("duckdb", reason="needs the extra archive")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / damaged.name).write_bytes(damaged.read_bytes())
    words = ("archive", "run", tmp_path / "in", tmp_path / "out", "--workers", "here")
    assert run_here(*words).returncode == 0
    assert f"{damaged.name}: not all of it is in the archive: " in caplog.text
    assert "could not be decoded" in caplog.text
    caplog.clear()
    thinned = tmp_path / "in" / "thinned.mcap"  # of which the archive has all that there is
    words = ("encode", "sim:room?frames=2", thinned, "--reduction", "random", "--keep-fraction", "0.2")
    assert run_here(*words).returncode == 0
    assert run_here("archive", "run", tmp_path / "in", tmp_path / "out", "--workers", "here").returncode == 0
    assert "not all of it" not in caplog.text


def test_the_python_interface_says_what_it_could_not_read(damaged, caplog):
    """A loop over `read_frames` ended as if the recording were whole."""
    assert len(list(read_frames(damaged))) < 10
    assert caplog.text.count("could not be decoded") == 1


def test_what_is_measured_of_a_thinned_recording_is_only_a_part(tmp_path, caplog):
    """`bench` showed the thinned frames as if they were the drive: `rmse 0.00`, `identical`, 20 % of its points."""
    thinned = tmp_path / "thinned.mcap"
    words = ("--reduction", "random", "--keep-fraction", "0.2")
    assert run_here("encode", "sim:room?frames=2", thinned, *words).returncode == 0
    assert run_here("bench", thinned).returncode == 0
    assert "only in part: 2 frames of which not all returns were sent" in caplog.text
