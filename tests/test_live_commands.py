"""publish, subscribe and demo as a user runs them: separate processes that come, go and are killed."""

import io
import json
import shlex
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest

from lidarcodec.commands.publish.command import say_begun, too_much
from lidarcodec.transport import Endpoints
from tests import packets as made
from tests.command_line import COMMAND, environment, run, run_here, start, the_one_line
from tests.commands.test_json import check
from tests.drives import simulated
from tests.packets import payloads_in
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

PIPE_TO_NOBODY = "{} | true; exit ${{PIPESTATUS[0]}}"


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return simulated("sim:city", tmp_path_factory.mktemp("town") / "town.pcap", "--frames", 12)


@pytest.fixture
def endpoint():
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def subscriber(endpoint):
    """Function that starts a subscriber; it is gone after the test, whatever happened."""
    started = []

    def begin(*words):
        started.append(start("subscribe", "car/roof", "--listen", endpoint, "--json", *words))
        return started[-1]

    yield begin
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


def publish(capture, endpoint, *words):
    return ("publish", capture, "--vehicle", "car", "--sensor", "roof", "--connect", endpoint, *words)


def test_every_frame_of_a_capture_arrives_and_both_sides_end_by_themselves(capture, endpoint, subscriber, tmp_path):
    receiving = subscriber("--until-end", "--record", tmp_path / "kept")
    published = run(*publish(capture, endpoint, "--rate", "max"))
    assert published.returncode == 0, published.stderr
    assert published.stdout.startswith("car/roof: 12 frames")
    out, complaints = receiving.communicate(timeout=90)
    assert receiving.returncode == 0, complaints
    summary = json.loads(out)
    assert (summary["frames"], summary["errors"]) == (12, {})
    (recording,) = (tmp_path / "kept").glob("*.mcap")
    assert json.loads(run_here("verify", recording, capture, "--json").stdout)["packets_identical"] is True


def test_a_stream_that_is_not_there_is_reported_and_waited_for_and_a_loop_goes_on(capture, endpoint, subscriber):
    receiving = subscriber("--frames", "20")
    said = receiving.stderr.readline()
    assert "nobody publishes car/roof yet; waiting" in said
    sending = start(*publish(capture, endpoint, "--rate", "40", "--loop", "--json"))
    out, complaints = receiving.communicate(timeout=60)
    sending.terminate()
    told, wrong = sending.communicate(timeout=90)
    assert (receiving.returncode, sending.returncode) == (0, 0), complaints + wrong
    summary, (status,) = json.loads(out), json.loads(told)["streams"]
    check("subscribe", summary)
    check("publish", {"streams": [status]})
    assert summary["frames"] >= 20  # of a capture of 12
    assert status["assembled"] > 12


def test_a_live_stream_is_converted_to_points(capture, endpoint, tmp_path):
    out = tmp_path / "a.pcd"
    receiving = start("convert", "zenoh:car/roof", out, "--listen", endpoint, "--json")
    published = run(*publish(capture, endpoint, "--rate", "max"))
    told, complaints = receiving.communicate(timeout=60)
    assert (published.returncode, receiving.returncode) == (0, 0), complaints
    assert json.loads(told)["frames"] == 12
    assert json.loads(told)["bytes"] == out.stat().st_size
    refused = run_here("convert", "zenoh:car/roof", tmp_path / "a.pcap")
    assert "lidarcodec subscribe" in the_one_line(refused)


def test_fewer_frames_than_were_asked_for_are_an_error(capture, endpoint, subscriber):
    receiving = subscriber("--until-end", "--frames", "100")
    assert run(*publish(capture, endpoint, "--rate", "max")).returncode == 0
    out, complaints = receiving.communicate(timeout=90)
    assert (receiving.returncode, json.loads(out)["frames"]) == (1, 12)
    assert "only 12 of 100 frames came" in complaints


def test_a_recording_that_stopped_is_told_by_the_exit_code_of_both_sides(capture, endpoint, subscriber, tmp_path):
    in_the_way = tmp_path / "file"
    in_the_way.write_text("no folder")
    receiving = subscriber("--until-end", "--record", in_the_way)
    published = run(*publish(capture, endpoint, "--rate", "max", "--record", in_the_way))
    out, complaints = receiving.communicate(timeout=90)
    assert json.loads(out)["frames"] == 12  # what was received is told all the same
    assert published.stdout.startswith("car/roof: 12 frames")
    for code, said in ((published.returncode, published.stderr), (receiving.returncode, complaints)):
        assert code == 1
        assert "not all of the stream was recorded" in said.splitlines()[-1]
    both = tmp_path / "publish.yaml"
    sensor = {"name": "roof", "source": str(capture), "record": {"folder": str(in_the_way)}}
    both.write_text(json.dumps({"vehicle": "car", "listen": [endpoint], "sensors": [sensor]}))  # JSON is YAML
    published = run("publish", "--config", both)
    assert (published.returncode, "car/roof: File exists" in published.stderr) == (1, True), published.stderr


def test_a_subscriber_goes_on_after_its_publisher_was_killed_and_started_again(capture, endpoint, subscriber):
    receiving = subscriber("--frames", 8)
    for _ in range(2):
        with start(*publish(capture, endpoint, "--rate", 10)) as publishing:
            time.sleep(1.6)
            publishing.send_signal(signal.SIGKILL)
            publishing.communicate()
    with start(*publish(capture, endpoint, "--rate", 10, "--loop")) as publishing:
        out, complaints = receiving.communicate(timeout=90)
        publishing.send_signal(signal.SIGTERM)
        publishing.communicate(timeout=90)
    assert receiving.returncode == 0, complaints
    summary = json.loads(out)
    assert summary["frames"] >= 8
    assert summary["errors"] == {}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_both_sides_with_code_0_and_a_summary(number, endpoint, subscriber, tmp_path):
    kept = tmp_path / "kept"
    receiving = subscriber("--record", kept)
    with start(*publish("sim:city", endpoint)) as publishing:
        patience = time.monotonic() + 60
        while sum(file.stat().st_size for file in kept.glob("*")) < 500_000 and time.monotonic() < patience:
            time.sleep(0.1)  # until some frames have come, however slow the machine is
        publishing.send_signal(number)
        publishing.send_signal(signal.SIGTERM)  # `timeout`, for one, makes two signals of one
        said, complaints = publishing.communicate(timeout=90)
    assert publishing.returncode == 0, complaints
    assert " a second, in " in said
    receiving.send_signal(number)
    out, complaints = receiving.communicate(timeout=90)
    assert receiving.returncode == 0, complaints
    assert json.loads(out)["frames"] > 0


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (("publish", "sim:city", "--rate", "fast"), 2, "--rate fast"),
        (("publish", "sim:city", "--link", "fast"), 2, "--link must be one of 1mbit, 2mbit, 5mbit, lan"),
        (("publish", "--config", "cars.yaml", "--link", "lan"), 2, "--link cannot be combined with --config"),
        (("publish", "sim:city", "--record", "kept", "--record-gb", "nan"), 2, "--record-gb"),
        (("publish", "sim:city", "--record-as", "lossless"), 2, "--record DIR"),
        (("serve", "--recordings-gb", "inf"), 2, "--recordings-gb"),
        (("publish", "sim:city", "--connect", "somewhere"), 2, "tcp/192.168.1.5:7447"),
        (("publish", "sim:city", "--vehicle", "a/b"), 2, "a/b"),
        (("publish", "sim:city", "--zenoh-config", "nowhere.json5"), 1, "nowhere.json5"),
        (("publish", "nowhere.pcap"), 1, "nowhere.pcap"),
        (("subscribe", "just-one-part"), 2, "VEHICLE/SENSOR"),
        (("subscribe", "--udp", "127.0.0.1:many"), 2, "127.0.0.1:many"),
        (("demo", "--codec", "mp3"), 2, "choose one of"),
        (("demo", "--source", "nowhere.pcap"), 1, "nowhere.pcap"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(words, code, says):
    result = run(*words) if words[0] == "demo" else run_here(*words)
    assert result.returncode == code, result.stderr
    assert says in the_one_line(result)


@pytest.mark.sweep
def test_the_demo_ends_by_itself_with_a_summary_and_a_picture(tmp_path):
    """Whatever a user has set for publishers of his own."""
    mine = {"SENSOR": "roof", "RECORD": str(tmp_path / "kept"), "RATE": "1"}
    result = run(
        "demo",
        "--seconds",
        "3",
        "--no-browser",
        cwd=tmp_path,
        **{f"LIDARCODEC_PUBLISH_{name}": value for name, value in mine.items()},
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert not (tmp_path / "kept").exists()
    for word in ("ratio", "bits per point", "latency p50 / p99", "replaced", "byte for byte"):
        assert word in result.stdout
    assert (tmp_path / "demo-out" / "last-frame.png").stat().st_size > 100_000


@pytest.mark.sweep
def test_the_demo_needs_no_folder_to_write_in(tmp_path):
    (tmp_path / "demo-out").write_text("in the way")
    result = run("demo", "--seconds", "1", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "not saved" in result.stdout


@pytest.mark.sweep
@pytest.mark.parametrize("shell", ["exec 3>&1 1>&-; {}", PIPE_TO_NOBODY])
def test_the_demo_needs_nobody_who_reads(tmp_path, shell):
    command = shell.format(shlex.join([*COMMAND, "demo", "--seconds", "1"]))
    ended = subprocess.run(
        ["bash", "-c", command],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("record_as", ["packets", "lossless"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_what_a_sensor_sent_last_is_in_the_recording_of_a_publisher_that_is_ended(tmp_path, number, record_as):
    """What waited in the queue was lost without a word, and of a lossless stream the last frame."""
    packets = made.turning(800)
    kept = tmp_path / "kept"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        sensor.bind(("127.0.0.1", 0))
        port = free_port()
        process = start("publish", f"udp://127.0.0.1:{port}", "--record", kept, "--record-as", record_as)
        try:
            assert eventually(lambda: f":{port:04X} " in Path("/proc/net/udp").read_text(), 60)
            for packet in packets:
                sensor.sendto(packet.payload, ("127.0.0.1", port))
                time.sleep(0.0002)
            assert eventually(lambda: list(kept.glob("*.mcap")), 60), "it has begun"
            for packet in packets:
                sensor.sendto(packet.payload, ("127.0.0.1", port))
                time.sleep(0.0001)
        finally:
            process.send_signal(number)
            said, complaint = process.communicate(timeout=60)
    assert process.returncode == 0, complaint
    assert "lost packets" not in complaint
    (file,) = kept.glob("*.mcap")
    found = payloads_in(file)
    assert len(found) == 1600, said + complaint
    assert found == [packet.payload for packet in packets] * 2


def test_what_is_published_and_whether_it_leaves_this_machine_is_reported(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    for stream, endpoints, told in (
        (
            Terminal(),
            Endpoints(),
            "publishing car-7/roof on this machine only, to all its users (--connect or --listen sends it elsewhere)",
        ),
        (Terminal(), Endpoints(connect=("tcp/127.0.0.1:7447",)), "publishing car-7/roof; Ctrl-C stops\n"),
        (io.StringIO(), Endpoints(connect=("tcp/127.0.0.1:7447",)), "publishing car-7/roof\n"),
    ):
        monkeypatch.setattr("sys.stderr", stream)
        say_begun(["car-7/roof"], endpoints)
        assert stream.getvalue().startswith(told)
    monkeypatch.setattr("sys.stderr", stream := Terminal())
    say_begun(["car-7/roof"], Endpoints(connect=("tcp/127.0.0.1:7447",)), waits=True)
    assert "begins when there is a receiver" in stream.getvalue()


def test_what_cannot_listen_does_not_say_first_that_it_publishes(tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        (tmp_path / "car.yaml").write_text(
            f'vehicle: car\nlisten: ["{endpoint}"]\nsensors: [{{name: roof, source: "sim:road"}}]\n'
        )
        for words in (("sim:road?frames=1", "--listen", endpoint), ("--config", tmp_path / "car.yaml")):
            done = run_here("publish", *words)
            assert done.returncode == 1
            assert "publishing" not in the_one_line(done)


@pytest.mark.parametrize(
    ("target", "codec", "encode_ms", "arrive_ms", "told"),
    [
        (800, "auto", 200.0, 90.0, "encoding, 200 ms a frame"),
        (800, "riddle", 200.0, None, "encoding, 200 ms a frame: choose a quicker codec, or auto"),
        (800, "auto", 20.0, 90.0, "waiting for the link, 90 ms a message: lower target_kbps"),
        (None, "pcodec", 2.0, 900.0, "waiting for the link, 900 ms a message: --link 1mbit sends less"),
    ],
)
def test_advice_names_what_is_slow_and_not_what_is_done_already(target, codec, encode_ms, arrive_ms, told):
    settings = {"target_kbps": target, "codec": codec}
    times = {"encode_ms": {"mean": encode_ms}, "flight": {"arrive_ms": {"mean": arrive_ms}}}
    assert (
        too_much({"frames": 10, "replaced": 30, "settings": settings, **times})
        == f"; most of the time went into {told}"
    )
    assert too_much({"frames": 10, "replaced": 5, "settings": settings, **times}) == ""
