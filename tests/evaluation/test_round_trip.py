"""What does not come out of messages as it went in is found, whatever it is; what does is counted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lidarcodec.cli import run
from lidarcodec.codecs import pcodec
from lidarcodec.codecs.jpeg_layered import CODEC as LAYERED
from lidarcodec.errors import RoundTripError
from lidarcodec.evaluation.round_trip import RoundTrip, difference
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.planes.intensity import Quality, reduced
from lidarcodec.settings import settings_from
from lidarcodec.sources.captures.pcap_writer import PcapWriter
from lidarcodec.wire import pack
from tests.contracts import frames
from tests.packets import turning

SENT = [frames.scene(3, index=index) for index in range(5)]


@pytest.mark.parametrize(
    "values",
    [
        {"codec": "pcodec"},
        {"codec": "predictive", "max_error_m": 0.05, "intensity": "levels=8"},
        {"codec": "riddle", "target_kbps": 20000.0},
        {"codec": "jpeg-layered", "intensity": "levels=5"},
        {"codec": "raw", "intensity": "error=9"},
        {"codec": "jpeg-layered", "intensity": "off"},
        {"codec": "raw", "reduction": "random", "keep_fraction": 0.4},
        {"codec": "h264", "reduction": "random", "keep_fraction": 0.4},
    ],
)
def test_what_holds_is_counted(values: dict[str, object]) -> None:
    encoder = StreamEncoder(settings_from(values))
    check = RoundTrip(encoder.settings)
    came = 0
    for frame in SENT:
        messages = encoder.encode(frame)
        if not encoder.left_out:
            assert encoder.reduced is not None
            check.sent(encoder.reduced)
        came += sum(len(check.message(pack(message))) for message in messages)
    came += sum(len(check.message(pack(message))) for message in encoder.flush()) + len(check.end())
    assert (came, check.compared, check.waiting) == (5, 5, 0)


def one_off(ranges: np.ndarray, by: int) -> np.ndarray:
    """The ranges with one return moved."""
    moved = ranges.copy()
    moved.flat[np.flatnonzero(ranges > 100)[7]] -= by
    return moved


WHOLE = frames.scene(3).with_(pose=frames.pose())
SPOILS: dict[str, tuple[Callable[[Frame], dict[str, object]], str]] = {
    "a range": (
        lambda frame: {"range": one_off(frame.range, 1)},
        "a range error of 0.002 m, although only 0 m are allowed",
    ),
    "a return": (lambda frame: {"range": np.where(np.arange(frame.width) == 4, 0, frame.range)}, "returns"),
    "an intensity": (lambda frame: {"intensity": frame.intensity // 2}, "different intensities"),
    "a column": (
        lambda f: {n: getattr(f, n)[:, 1:] for n in ("range", "intensity", "azimuth", "fired")},
        "17 columns instead of 18",
    ),
    "azimuth": (lambda frame: {"azimuth": frame.azimuth + np.uint16(1)}, "azimuths"),
    "what fired": (lambda frame: {"fired": ~frame.fired}, "azimuths"),
    "the time": (lambda frame: {"stamp_ns": frame.stamp_ns + 1}, "time"),
    "the pose": (lambda frame: {"pose": None}, "pose"),
    "the calibration": (lambda frame: {"sensor": frames.sensor(9)}, "calibration"),
    "the packets": (lambda frame: {"side": None}, "packets"),
    "other packets": (lambda frame: {"side": frames.irregular_side(3).side}, "packets"),
}


@pytest.mark.parametrize("what", SPOILS)
def test_what_does_not_is_named(what: str) -> None:
    settings = settings_from({"codec": "pcodec"})
    assert difference(WHOLE, WHOLE, settings, 1) is None
    spoil, told = SPOILS[what]
    found = difference(WHOLE.with_(**spoil(WHOLE)), WHOLE, settings, 1)
    assert found is not None
    assert told in found


def test_each_is_judged_by_what_its_settings_promise() -> None:
    ranges = WHOLE.with_(range=one_off(WHOLE.range, 26))
    for values, step, holds in (
        ({"codec": "pcodec", "max_error_m": 0.05}, 51, False),
        ({"codec": "pcodec", "max_error_m": 0.1}, 101, True),
        ({"codec": "pcodec", "max_error_m": 0.1}, 51, False),
        ({"codec": "pcodec", "max_error_m": 0.05}, 101, False),
        ({"codec": "pcodec", "target_kbps": 500.0}, 101, True),
        ({"codec": "jpeg"}, 1, True),
    ):
        assert (difference(ranges, WHOLE, settings_from(values), step) is None) is holds, values
    four = WHOLE.with_(intensity=reduced(WHOLE, Quality(4)))
    for intensity, holds in (("levels=4", True), ("levels=6", False), ("off", False), ("lossless", False)):
        assert (difference(four, WHOLE, settings_from({"intensity": intensity}), 1) is None) is holds, intensity
    steered = settings_from({"codec": "pcodec", "target_kbps": 500.0})
    assert difference(four, WHOLE, steered, 1, Quality(255)) is None
    scrambled = WHOLE.with_(intensity=np.where(WHOLE.valid, np.flip(four.intensity), 0).astype(np.uint8))
    assert (
        difference(scrambled, WHOLE, steered, 1, Quality(255))
        == "larger intensity errors than any choice of values allows"
    )


def test_a_frame_that_does_not_come_out_is_missed() -> None:
    encoder, check = StreamEncoder(settings_from({"codec": "zstd"})), RoundTrip(settings_from({"codec": "zstd"}))
    messages = [message for frame in SENT[:2] for message in encoder.encode(frame)]
    check.sent(SENT[0])
    check.message(pack(messages[0]))
    with pytest.raises(RoundTripError, match="the decoder of zstd returned frame 1, which was not encoded"):
        check.message(pack(messages[1]))
    check.sent(SENT[2])
    with pytest.raises(RoundTripError, match="the decoder of zstd did not return frame 2: please"):
        check.end()
    check.sent(SENT[3])
    with pytest.raises(RoundTripError, match="frame 2, nor did 1 more"):
        check.end()


def cut(data: bytes) -> bytes:
    """What was lost of large groups: their end."""
    return data[: len(data) - len(data) // 5]


@pytest.fixture
def capture(tmp_path):
    """A capture of two frames and a bit."""
    with (tmp_path / "in.pcap").open("wb") as handle:
        writer = PcapWriter(handle)
        for packet in turning(40):
            writer.write(packet)
    return tmp_path / "in.pcap"


def nearer(values: np.ndarray, step: int) -> np.ndarray:
    """What a quantiser that rounds wrongly gives."""
    return np.maximum(values, 2) // step


@pytest.mark.parametrize("command", ["encode", "convert"])
@pytest.mark.parametrize(
    ("codec", "spoilt", "told"),
    [
        ("pcodec", (pcodec, "compress_groups", lambda *given: cut(compress(*given))), "cannot be decoded"),
        ("pcodec", (pcodec, "quantise", nearer), "m are allowed"),
        ("jpeg-layered", (LAYERED.encoder, "flush", lambda self: []), "did not return"),
    ],
)
def test_encode_keeps_nothing_that_does_not_decode(command, codec, spoilt, told, capture, monkeypatch, capsys):
    out = capture.with_name("out.mcap")
    given = [command, str(capture), str(out), "--set", f"codec={codec}", "--set", "framing=packets:16"]
    given += ["--set", "max_error_m=0.05"] if codec == "pcodec" else []
    monkeypatch.setattr(*spoilt)
    assert run(given) == 1
    assert told in capsys.readouterr().err
    assert not out.exists()
    monkeypatch.undo()
    assert run(given) == 0
    assert "all decoded again and compared" in capsys.readouterr().out
    assert out.exists()


compress = pcodec.compress_groups


def test_what_a_lossy_recording_lost_is_reported_where_it_is_written(tmp_path, capsys, caplog):
    """A user who deletes the original would have to ask for it first."""
    assert run(["encode", "sim:road?frames=2", str(tmp_path / "all.mcap")]) == 0
    assert capsys.readouterr().out.rstrip().endswith("all decoded again and compared")
    words = (
        "--codec",
        "predictive",
        "--set",
        "max_error_m=0.05",
        "--set",
        "intensity=off",
        "--set",
        "reduction=columns:4",
    )
    assert run(["encode", "sim:road?frames=2", str(tmp_path / "few.mcap"), *words]) == 0
    said = capsys.readouterr().out
    assert "compared, 25." in said
    assert "% of the returns kept, ranges off by at most 0.05 m, intensities left out" in said
    two_layers = ["--codec", "predictive", "--set", "base_error_m=0.1", "--set", "max_error_m=0.02"]
    assert run(["encode", "sim:road?frames=2", str(tmp_path / "layers.mcap"), *two_layers]) == 0
    assert "compared, ranges off by at most 0.02 m" in capsys.readouterr().out  # not the error of the base
    assert run(["convert", str(tmp_path / "few.mcap"), str(tmp_path / "few.pcap")]) == 0
    assert "2 frames of which not all returns were sent" in caplog.text


@pytest.mark.sweep
def test_a_target_that_is_kept_by_leaving_out_frames_is_missed_if_settings_are_in_the_way(tmp_path, capsys):
    """The advice of the first error led to a file without nine of twelve frames, and exit code 0."""
    words = (
        "--set",
        "max_error_m=0.01",
        "--set",
        "intensity=lossless",
        "--set",
        "reduction=all",
        "--set",
        "target_kbps=2500",
    )
    out = tmp_path / "missed.mcap"
    assert run(["encode", "sim:city?frames=8", str(out), *words]) == 1
    said = capsys.readouterr().err
    assert "frames were left out, and about" in said
    assert "for all frames" in said
    assert run(["encode", "sim:city?frames=8", str(out), "--force", "--allow-missed", *words]) == 0
