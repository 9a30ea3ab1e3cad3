"""What a user of a VLP-16 or an Ouster would lose here: the commands that they type first."""

from __future__ import annotations

import json
import lzma
from pathlib import Path

import laspy
import numpy as np
import pytest

from lidarcodec.commands.outputs.base import NARROW
from lidarcodec.commands.outputs.ply import PlyOutput
from lidarcodec.sources import open_source
from lidarcodec.sources.base import PacketSource
from tests.command_line import run, run_here, the_one_line
from tests.packets import payloads_in, sensor, turning
from tests.sensors.captures import CAPTURES, payloads
from tests.sensors.made_frames import block_sensor, made_frames, ouster, packets_of_model
from tests.sensors.ouster_packets import FOLDER
from tests.sweeps import sampled

OUSTER = "OS-0-32-U1_v2.2.0_1024x10"
NAMES = {"vlp16": CAPTURES["vlp16"], "os0-32": f"{FOLDER}/{OUSTER}.pcap.xz"}
VLP16 = (b"\xff\xee\x10\x27" + b"\xe8\x03\x40" * 32) * 12 + bytes(4) + b"\x37\x22"


@pytest.fixture(scope="module", params=sampled(NAMES, ["os0-32"]))
def capture(request, data_file, tmp_path_factory) -> tuple[str, Path]:
    """Model, and a capture of it."""
    model = request.param
    folder = tmp_path_factory.mktemp(model)
    path = folder / "drive.pcap"
    path.write_bytes(lzma.decompress(data_file(NAMES[model]).read_bytes()))
    if model.startswith("os"):
        (folder / "drive.json").write_bytes(data_file(f"{FOLDER}/{OUSTER}.json").read_bytes())
    return model, path


@pytest.fixture(scope="module")
def recording(capture) -> Path:
    """Its first frame, coded."""
    path = capture[1].with_suffix(".mcap")
    done = run("encode", capture[1], path, "--codec", "predictive", "--frames", "1")
    assert done.returncode == 0, done.stderr
    return path


def test_info_says_which_sensor_it_is_and_why(capture) -> None:
    model, path = capture
    done = run("info", path, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert model in json.dumps(told)
    assert "evidence" in json.dumps(told)
    shown = run("info", path)
    assert model in shown.stdout


def test_info_explains_a_recording(capture, recording) -> None:
    done = run("info", recording)
    assert done.returncode == 0, done.stderr


def test_verify_finds_every_packet_again(capture, recording) -> None:
    whole = recording.with_name("whole.mcap")
    assert run("encode", capture[1], whole, "--codec", "zstd").returncode == 0
    done = run("verify", whole, capture[1])
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_decoded_capture_has_the_packets(capture, recording, tmp_path) -> None:
    done = run("decode", recording, tmp_path / "out.pcap")
    assert done.returncode == 0, done.stderr
    before, after = payloads(capture[1]), payloads(tmp_path / "out.pcap")
    assert len(after) > 10
    assert after == before[: len(after)]


@pytest.mark.parametrize("ending", ["ply", "las", "npz"])
def test_decoded_points_are_those_of_the_frame(capture, recording, tmp_path, ending: str) -> None:
    out = tmp_path / f"out.{ending}"
    done = run("decode", recording, out)
    assert done.returncode == 0, done.stderr
    made = next(path for path in (out, *sorted(tmp_path.rglob(f"*.{ending}"))) if path.is_file())
    with open_source(recording) as source:
        rows = source.sensor.rows
    if ending == "npz":
        with np.load(made) as found:
            image = next(found[name] for name in found.files if name.endswith("/range"))
        assert image.shape[0] == rows
    elif ending == "las":
        assert len(laspy.read(made)) > 1000
    else:
        assert made.read_bytes().startswith(b"ply\n")


def test_bench_measures_it(capture) -> None:
    done = run("bench", capture[1], "--codec", "zstd", "--frames", "1")
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_codec_of_pictures_takes_it(capture, tmp_path) -> None:
    pytest.importorskip("imagecodecs")
    done = run("encode", capture[1], tmp_path / "out.mcap", "--codec", "jxl")
    assert done.returncode == 0, done.stderr
    assert run("decode", tmp_path / "out.mcap", tmp_path / "out.pcap").returncode == 0
    assert payloads(tmp_path / "out.pcap") == payloads(capture[1])


def made_capture(folder: Path, sent: list[bytes]) -> Path:
    from tests.sources import captures as c

    path = folder / "made.pcap"
    path.write_bytes(c.pcap(map(c.frame, sent)))
    return path


def test_the_model_that_is_named_is_taken(tmp_path) -> None:
    path = made_capture(tmp_path, [VLP16] * 30)
    for model in ("vlp16", "packets"):
        done = run("encode", path, tmp_path / f"{model}.mcap", "--model", model)
        assert done.returncode == 0, done.stderr
        done = run("decode", tmp_path / f"{model}.mcap", tmp_path / f"{model}.pcap")
        assert done.returncode == 0, done.stderr
        assert payloads(tmp_path / f"{model}.pcap") == [VLP16] * 30


def test_a_model_that_nobody_knows_is_refused_with_all_names(tmp_path) -> None:
    done = run("info", made_capture(tmp_path, [VLP16] * 3), "--model", "vlp17")
    assert done.returncode != 0
    assert "vlp17" in done.stderr
    assert "vlp16" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_wrong_model_is_told_and_any_spelling_of_the_right_one_is_taken(tmp_path, caplog) -> None:
    path = made_capture(tmp_path, [VLP16] * 3)
    with open_source(f"{path}?model=VLP-16") as source:
        assert source.sensor.model == "vlp16"
    assert not caplog.records
    for model in ("hdl64e", "vlp32c", "xt32"):  # without a word, points would be wrong, or none
        caplog.clear()
        open_source(f"{path}?model={model}").close()
        assert f"--model says {model}, but these are packets of another sensor" in caplog.text
        assert "VLP-16, strongest return)" in caplog.text


def test_packets_of_another_model_than_the_named_one_come_back_too(tmp_path) -> None:
    path = made_capture(tmp_path, [VLP16] * 30)
    done = run("encode", path, tmp_path / "out.mcap", "--model", "xt32")
    assert "Traceback" not in done.stderr
    if done.returncode == 0:
        assert run("decode", tmp_path / "out.mcap", tmp_path / "out.pcap").returncode == 0
        assert payloads(tmp_path / "out.pcap") == [VLP16] * 30


class Replaced(PacketSource):
    """A live HDL-64E whose place another sensor takes, and which then comes back."""

    def __init__(self, model):
        super().__init__(sensor(), live=True)
        self._model = model

    def packets(self):
        other = block_sensor(self._model)
        for model, packets in (
            (sensor(), turning(348)),
            (other, packets_of_model(other, "single", 100)),
            (sensor(), turning(348)),
        ):
            self.sensor = model
            yield from packets


def test_packets_of_another_model_cost_no_live_recording(tmp_path, monkeypatch):
    """Who sends them from the sensor's address would end it, and nothing of it would be left."""
    monkeypatch.setattr("lidarcodec.commands.encode.open_source", lambda *_, **__: Replaced("vlp16"))
    out = tmp_path / "out.mcap"
    done = run_here("encode", "udp://0.0.0.0", str(out), "--set", "base_error_m=0.1")
    assert done.returncode == 1
    assert "frames of another sensor were left out" in the_one_line(done)
    assert "4 frames" in done.stdout  # each of the two runs begins and ends within a turn


def test_each_scan_of_a_bag_is_a_turn_and_two_sensors_keep_their_topics_apart(tmp_path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="read back by rosbags (extra `bridges`)")
    words = ("--topic", "/front/velodyne_packets", "--with-clouds", "--skip", 1, "--frames", 2)
    done = run_here("convert", "sim:city?sensor=vlp16&frames=4", tmp_path / "bag", *words)
    assert done.returncode == 0, done.stderr
    with rosbag2.Reader(tmp_path / "bag") as reader:
        counts = {one.topic: one.msgcount for one in reader.connections}
    assert counts == {"/front/velodyne_packets": 2, "/front/velodyne_points": 2, "/tf": 2}


def test_packets_of_another_length_cost_no_bag(tmp_path, monkeypatch):
    out = tmp_path / "bag"
    monkeypatch.setattr("lidarcodec.commands.convert.convert.open_source", lambda *_, **__: Replaced("xt16"))
    done = run_here("convert", "udp://0.0.0.0", str(out), "--frames", "9")
    assert done.returncode == 1
    assert "100 packets of another length were left out" in the_one_line(done)
    assert payloads_in(out) == [packet.payload for packet in turning(348)] * 2


def test_a_ply_of_two_sensors_wraps_no_intensity(tmp_path, caplog):
    """The first frame says how many bits there are; 300 would become 44."""
    frames = [
        made_frames(model, layout, 2, 1)[0]
        for model, layout in ((block_sensor("vlp16"), "single"), (ouster("LEGACY", 16, "OS-0-16"), "legacy"))
    ]
    most = int(frames[1].cloud()["intensity"].max())
    assert most > 255
    writer = PlyOutput(tmp_path / "a.ply")
    for frame in frames:
        writer.write(frame.with_(index=int(frame is frames[1])), frame.cloud())
    writer.close()
    text = (tmp_path / "a.ply").read_bytes()
    points = np.frombuffer(text[text.index(b"end_header\n") + 11 :], NARROW)
    found = points["intensity"][points["frame"] == 1]
    assert np.array_equal(found, np.minimum(frames[1].cloud()["intensity"], 255))
    assert "from frame 1 on are clipped to 255" in caplog.text


def test_names_and_the_sensor_of_a_recording_are_told(tmp_path) -> None:
    path, recording, bare = made_capture(tmp_path, [VLP16] * 90), tmp_path / "out.mcap", tmp_path / "bare.mcap"
    named = ("--vehicle", "car-7", "--sensor", "roof")
    assert run_here("encode", path, recording, *named).returncode == 0
    assert run_here("convert", path, bare, "--as", "packets", *named).returncode == 0
    for one in (recording, bare):
        told = json.loads(run_here("info", one, "--json").stdout)
        assert (told["model"], told["rows"]) == ("vlp16", 16), "told by one message, or by the packets"
        assert (told["metadata"]["vehicle"], told["metadata"]["sensor"]) == ("car-7", "roof")
    done = run_here("convert", path, tmp_path / "out.pcap", "--sensor", "roof")
    assert done.returncode == 2
    assert "only for recordings" in done.stderr
