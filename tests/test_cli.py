"""The command line as a user runs it: real processes, their exit codes, and what they write where."""

import json
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

import lidarcodec
from lidarcodec.cli import app
from lidarcodec.commands.running.options import command_line
from lidarcodec.recording import read_recording
from tests.command_line import COMMAND, environment, run, run_here, the_one_line
from tests.conftest import ROOT
from tests.transport.test_contract import eventually


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["benhc"], "bench"),
        (["bench"], "SOURCE"),
        (["bench", "sim:city", "--frmes", "3"], "--frames"),
        (["bench", "sim:city", "--frames", "0"], "'--frames': must be at least 1"),
        (["bench", "sim:city", "--frames", "2", "--codec", "mp3"], "choose one of raw, zstd, pcodec"),
        (["bench", "sim:city", "--frames", "2", "--set", "colour=red"], "'colour'"),
        (["bench", "sim:city", "--frames", "2", "--set", "max_error_m=-1"], "max_error_m"),
        (["bench", "sim:city", "--frames", "2", "--set", "level"], "key=value"),
        (["bench", "sim:city"], "--frames N"),
        (["bench", "sim:moon?frames=1"], "moon"),
        (["bench", "http://example.org/x.pcap"], "http"),
        (["simulate", "sim:city", "out.txt", "--frames", "1"], ".pcap"),
        (["decode", "in.mcap", "out.xyz"], ".las"),
        (["info", "--message", "3"], "recording"),
        (["convert", "in.pcap", "out.ply", "--format", "ply"], "write --as FORMAT"),
        (["encode", "in.pcap", "out.mcap", "--max-error", "0.01"], "write --set max_error_m=VALUE"),
        (["encode", "in.pcap", "out.mcap", "--set", "level", "9"], "write --set level=VALUE"),
        (["convert", "in.pcap", "f_%04d.ply"], "a folder and --as ply"),
        (["encode", "sim:moon", "out.mcap"], "choose one of city"),
        (["simulate", "drive.pcap", "out.pcap"], "sim:motorway"),
        (["verify", "drive.mcap", "udp://127.0.0.1:2368"], "live"),
        (["bench", "sim:city?frames=1", "--plot", "results.doc"], ".png"),
        (["bench", "sim:city?frames=1", "--plot", "no-such-folder/results.png"], "no folder no-such-folder"),
    ],
)
def test_wrong_usage_is_one_line_that_says_what_to_do_and_code_2(words, says):
    result = run(*words) if words == ["benhc"] else run_here(*words)
    assert result.returncode == 2, result.stderr
    assert says in the_one_line(result)
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["info", "no-such-file.pcap"], "no-such-file.pcap"),
        (["bench", "no-such-file.pcap"], "no-such-file.pcap"),
        (["decode", "no-such-file.mcap", "out.pcap"], "no-such-file.mcap"),
        (["verify", "no-such-file.mcap", "sim:city?frames=1"], "no-such-file.mcap"),
        (["encode", "sim:city?frames=1", "no-such-folder/out.mcap"], "there is no folder no-such-folder"),
        (["bench", "sim:city?frames=1", "--calibration", "no-such-file.yaml"], "no-such-file.yaml"),
    ],
)
def test_failed_work_is_one_line_and_code_1(words, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(*words) if words[0] == "info" else run_here(*words)
    assert result.returncode == 1, result.stderr
    assert says in the_one_line(result)


def test_a_file_that_is_no_capture_is_refused_by_name(tmp_path):
    path = tmp_path / "holiday.pcap"
    path.write_bytes(b"\xff\xd8\xff\xe0 not a capture" * 100)
    result = run_here("info", path)
    assert result.returncode == 1
    assert "holiday.pcap" in the_one_line(result)


def test_debug_shows_the_traceback_wherever_it_stands():
    for words in (["--debug", "info", "nowhere.pcap"], ["info", "nowhere.pcap", "--debug"]):
        result = run_here(*words)
        assert result.returncode == 1
        assert "Traceback" in result.stderr
    assert "Traceback" in run("info", "nowhere.pcap", LIDARCODEC_DEBUG="1").stderr


def test_without_a_command_the_help_is_shown_and_help_answers_at_once():
    without = run()
    assert "Commands:" in without.stderr
    assert without.returncode == 2
    of_a_group = run_here("archive")
    assert "\n  query  Ask the index" in of_a_group.stderr, "its lines as they are, not joined to one"
    assert of_a_group.returncode == 2

    def at_once() -> bool:
        started = time.monotonic()
        shown = run("--help")
        assert shown.returncode == 0
        assert "bench" in shown.stdout
        return time.monotonic() - started < 5

    assert eventually(at_once), "at best, for the machine may be busy"


def test_help_shows_whole_sentences_and_no_variables():
    for words in (["--help"], *([*path, "--help"] for path, _ in commands_of(command_line(app)) if path)):
        shown = run_here(*words).stdout
        assert not [line for line in shown.partition("Commands:")[2].splitlines() if line.endswith("...")], words
        assert "env var" not in shown, words


@pytest.mark.parametrize(
    ("words", "offers"),
    [("lidarcodec enc", {"encode"}), ("lidarcodec publish --recor", {"--record", "--record-as", "--record-gb"})],
)
def test_a_shell_completes_commands_and_options(words, offers):
    shown = run(_LIDARCODEC_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(words.count(" ")))
    assert (shown.returncode, set(shown.stdout.split())) == (0, offers), shown.stderr


def test_every_option_has_an_environment_variable():
    result = run(
        "bench",
        "sim:city",
        "--json",
        LIDARCODEC_BENCH_CODEC="zstd",
        LIDARCODEC_BENCH_FRAMES="1",
        LIDARCODEC_BENCH_SET="level=1",
        LIDARCODEC_FRAMES="2",
        LIDARCODEC_ENCODE_CODEC="raw",
    )
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert [entry["codec"] for entry in found] == ["zstd"]
    assert found[0]["settings"]["codec_settings"] == {"level": 1}
    assert found[0]["frames"] == 1


def test_no_variable_changes_another_command():
    """LIDARCODEC_PORT was meant for `serve`, and changed `certs` too."""
    readers = Counter()
    for path, command in commands_of(command_line(app)):
        for one in command.params:
            if one.param_type_name == "option" and path:
                assert one.envvar, (path, one.opts)
                readers[one.envvar] += 1
    shared = {name for name, number in readers.items() if number > 1}
    assert shared == {f"LIDARCODEC_{name}" for name in ("CONNECT", "LISTEN", "ZENOH_CONFIG", "DATABASE_URL")}


def commands_of(command, path=()):
    yield path, command
    for word, inner in getattr(command, "commands", {}).items():
        yield from commands_of(inner, (*path, word))


BENCH_FIELDS = {
    "source", "codec", "settings", "frames", "frames_left_out", "points", "points_per_frame", "bits_per_point",
    "ratio", "kbps_at_10hz", "rmse_m", "max_error_m", "psnr_db", "kept_fraction", "lost", "invented",
    "bits_per_kept_point", "kb_per_frame", "packets_identical", "calibration", "encode_ms", "decode_ms",
    "version",
}  # fmt: skip


@pytest.mark.sweep
def test_bench_prints_one_object_a_codec_and_setting_with_every_field(tmp_path):
    picture = tmp_path / "bench.png"
    result = run(
        "bench", "sim:city", "--codec", "zstd,pcodec", "--set", "max_error_m=0,0.02", "--frames", 2, "--skip", 1,
        "--plot", picture, "--json",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    found = json.loads(result.stdout)
    assert [(entry["codec"], entry["settings"]["max_error_m"]) for entry in found] == [
        ("zstd", 0.0),
        ("zstd", 0.02),
        ("pcodec", 0.0),
        ("pcodec", 0.02),
    ]
    for entry in found:
        assert entry.keys() == BENCH_FIELDS
        bits = entry["bits_per_point"]
        parts = ("geometry", "intensity", "azimuth", "side", "header")
        assert bits["total"] == pytest.approx(sum(bits[part] for part in parts), abs=1e-5)
        assert bits["geometry"] == pytest.approx(bits["range"] + bits["mask"], abs=1e-5)
        assert entry["frames"] == 2
        assert (entry["lost"], entry["invented"], entry["kept_fraction"]) == (0, 0, 1)
        lossless = entry["settings"]["max_error_m"] == 0
        assert entry["packets_identical"] is lossless
        assert (entry["psnr_db"] is None) is lossless
        assert entry["max_error_m"] <= (0 if lossless else 0.02)
        assert entry["kbps_at_10hz"] == pytest.approx(348 * 1206 * 8 * 10 / 1000 / entry["ratio"], rel=1e-4)
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize(("command", "code"), [("encode", 130), ("publish", 0)])
def test_an_interrupt_while_the_command_line_is_loaded_ends_it_without_a_word(command, code):
    program = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a job in the background is told to ignore it
        "class Interrupting:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'typer': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "from lidarcodec.__main__ import main\n"
        "main()"
    )
    words = [sys.executable, "-c", program, command]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


def payloads(path):
    """Payloads of a capture of ours: 24 bytes, then 16 + 42 + 1206 for each packet."""
    body = path.read_bytes()[24:]
    assert len(body) % 1264 == 0
    return [body[at + 58 : at + 1264] for at in range(0, len(body), 1264)]


def test_what_was_encoded_comes_back_byte_for_byte_and_verify_says_so(tmp_path):
    capture, recording, back = tmp_path / "drive.pcap", tmp_path / "drive.mcap", tmp_path / "back.pcap"
    assert run_here("simulate", "sim:city?seed=3", capture, "--frames", 3).returncode == 0
    assert run("encode", capture, recording).returncode == 0
    assert run_here("decode", recording, back).returncode == 0
    assert payloads(back) == payloads(capture)
    found = json.loads(run("verify", recording, capture, "--json").stdout)
    assert (found["packets_identical"], found["max_error_m"], found["lost"]) == (True, 0, 0)


def test_verify_keeps_a_bound_and_refuses_another_source(tmp_path):
    recording = tmp_path / "drive.mcap"
    source = "sim:city?frames=3"
    assert run_here("encode", source, recording, "--set", "max_error_m=0.05", "--skip", 1).returncode == 0
    result = run_here("verify", recording, source, "--json", "--allow-part")
    found = json.loads(result.stdout)
    assert result.returncode == 0, result.stderr
    assert 0 < found["max_error_m"] <= 0.05
    assert found["packets_identical"] is False
    other = run_here("verify", recording, "sim:city?frames=3&seed=77")
    assert other.returncode == 1


@pytest.mark.sweep
def test_verify_judges_each_frame_by_its_own_message_where_a_target_bitrate_turns_the_bound(tmp_path):
    recording = tmp_path / "drive.mcap"
    source = "sim:city?frames=3"
    chosen = ("--set", "target_kbps=1500", "--set", "intensity=off")
    assert run_here("encode", source, recording, *chosen).returncode == 0
    result = run_here("verify", recording, source, "--json")
    found = json.loads(result.stdout)
    assert result.returncode == 0, result.stderr
    assert 0 < found["max_error_m"] <= 0.3
    assert found["left_out"] > 0
    assert (found["broken"], found["frames_beyond_their_bound"]) == ([], 0)


def test_a_cut_recording_decodes_as_far_as_it_goes_with_a_warning_and_code_0(tmp_path):
    recording = tmp_path / "drive.mcap"
    assert run_here("encode", "sim:city?frames=3", recording).returncode == 0
    whole = recording.read_bytes()
    recording.write_bytes(whole[: len(whole) * 2 // 3])
    result = run("decode", recording, tmp_path / "back.pcap")
    assert result.returncode == 0, result.stderr
    assert "warning" in the_one_line(result)
    recording.write_bytes(whole[:40])
    assert run_here("decode", recording, tmp_path / "nothing.pcap").returncode == 1


def test_info_explains_a_recording_and_each_message(tmp_path):
    recording = tmp_path / "drive.mcap"
    assert run_here("encode", "sim:city?frames=2", recording).returncode == 0
    found = json.loads(run_here("info", recording, "--json").stdout)
    assert found["messages"] == 2
    dump = run_here("info", recording, "--message", 1)
    assert dump.returncode == 0
    assert "checksum" in dump.stdout
    assert "as computed" in dump.stdout
    assert run_here("info", recording, "--message", 2).returncode == 2


def test_info_takes_a_recording_with_options_as_the_source_that_they_name(tmp_path):
    recording = tmp_path / "drive.mcap"
    assert run_here("encode", "sim:city?frames=1", recording).returncode == 0
    found = json.loads(run_here("info", f"{recording}?read=messages", "--json").stdout)
    assert (found["what"], found["packets"]) == ("recording drive.mcap, decoded messages", 359)
    assert "no packets" in the_one_line(run_here("info", f"{recording}?read=packets"))
    assert "'colour'" in the_one_line(run_here("info", f"{recording}?colour=red"))
    result = run_here("info", f"{recording}?read=messages", "--message", "0")
    assert result.returncode == 2
    assert "--message" in the_one_line(result)


def test_info_without_a_source_reports_this_installation():
    found = json.loads(run("info", "--json", LIDARCODEC_PUBLISH_SET="max_error_m=0.01").stdout)
    assert {"versions", "extras", "ports", "clock", "settings"} <= found.keys()
    assert found["settings"]["max_error_m"] == "0.01 (LIDARCODEC_PUBLISH_SET)"
    assert found["settings"]["codec"] == "pcodec (default)"


def test_what_is_read_is_never_written_over(tmp_path):
    """Opening it for writing would empty a recording that may be the only one of a drive."""
    path = tmp_path / "drive.mcap"
    assert run_here("encode", "sim:city?frames=1", path).returncode == 0
    before = path.read_bytes()
    link = tmp_path / "link.mcap"
    link.symlink_to(path)
    for out in (path, link):
        for words in ((), ("--force",)):
            result = run_here("encode", path, out, *words)
            assert result.returncode == 2
            assert "another name" in the_one_line(result)
    result = run_here("encode", "sim:city?frames=1", path, "--skip", "5", "--force")
    assert result.returncode == 1
    assert "nothing was encoded" in the_one_line(result)
    assert path.read_bytes() == before


@pytest.mark.sweep
def test_a_name_that_is_no_unicode_is_a_name_like_any_other(tmp_path):
    path = tmp_path / "drive\udcff.pcap"
    assert run_here("simulate", "sim:city", tmp_path / "drive.pcap", "--frames", "1").returncode == 0
    (tmp_path / "drive.pcap").rename(path)
    command = [*COMMAND, "encode", str(path), str(tmp_path / "out\udcff.mcap")]
    result = subprocess.run(command, capture_output=True, env=environment(), check=False)
    assert result.returncode == 0, result.stderr


def test_more_frames_than_can_be_counted_are_all_of_them(tmp_path):
    result = run_here("encode", "sim:city?frames=1", str(tmp_path / "out.mcap"), "--frames", str(10**20))
    assert result.returncode == 0, result.stderr
    result = run_here("encode", "sim:city?frames=1", str(tmp_path / "none.mcap"), "--skip", str(10**20))
    assert (result.returncode, "no frame" in the_one_line(result)) == (1, True)
    result = run_here("info", str(tmp_path / "out.mcap"), "--message", str(10**20))
    assert (result.returncode, "has no message" in the_one_line(result)) == (2, True)


def test_a_recording_cut_in_its_first_message_is_warned_of_once(tmp_path):
    path = tmp_path / "cut.mcap"
    assert run_here("encode", "sim:city?frames=2", path).returncode == 0
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    result = run("decode", path, tmp_path / "out.pcap")
    assert result.returncode == 0, result.stderr
    assert "cut.mcap was cut" in the_one_line(result)
    path.write_bytes(path.read_bytes()[:30_000])
    result = run_here("decode", path, tmp_path / "none.pcap")
    assert result.returncode == 1
    assert "cut.mcap" in the_one_line(result)


@pytest.mark.sweep
def test_a_closed_standard_output_is_no_traceback():
    command = f"{' '.join(COMMAND)} info sim:city?frames=1 >&-"
    result = subprocess.run(["sh", "-c", command], capture_output=True, text=True, env=environment(), check=False)
    assert "Traceback" not in result.stderr
    assert "unexpected" not in result.stderr


def test_poses_travel_with_the_frames(tmp_path):
    """A monitor that puts clouds into one map would lose where they were taken."""
    capture, poses = tmp_path / "town.pcap", tmp_path / "poses.txt"
    assert run_here("simulate", "sim:street", capture, "--frames", 2).returncode == 0
    first_s = 1_767_225_600
    poses.write_text("".join(f"{first_s + 0.1 * i:.1f} {2.0 * i} 0 0 0 0 0 1\n" for i in range(4)))
    out = tmp_path / "posed.mcap"
    assert run_here("encode", capture, out, "--poses", poses).returncode == 0
    with out.open("rb") as handle:
        decoder = lidarcodec.StreamDecoder()
        frames = [f for _, data in read_recording(handle) for f in decoder.decode(lidarcodec.unpack(data))]
    assert [frame.pose is not None for frame in frames] == [True, True]
    assert frames[0].pose[0, 3] == pytest.approx(0.0, abs=1e-3)
    assert frames[1].pose[0, 3] == pytest.approx(2.0, abs=0.1)


def test_verify_fails_when_a_part_of_the_recording_is_missing(tmp_path):
    capture, out = tmp_path / "town.pcap", tmp_path / "town.mcap"
    assert run_here("simulate", "sim:street", capture, "--frames", 3).returncode == 0
    assert run_here("encode", capture, out).returncode == 0
    assert run_here("verify", out, capture).returncode == 0
    whole = out.read_bytes()
    half = len(whole) // 2  # within the second message
    flipped = whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :]
    for damaged, says in ((whole[:half], "the end of the recording is missing"), (flipped, "damaged")):
        out.write_bytes(damaged)
        result = run_here("verify", out, capture)
        assert result.returncode == 1
        assert says in result.stdout


@pytest.mark.parametrize(
    ("words", "whole"), [(("--version",), False), (("encode", "sim:city?frames=1", "out.mcap"), True)]
)
def test_output_that_cannot_be_printed_is_an_error_of_its_own(tmp_path, words, whole):
    """Files are whole by then: a reader of only `No space left on device` would throw them away."""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMMAND, *words], stdout=full, stderr=subprocess.PIPE, text=True, env=environment(), cwd=tmp_path,
            timeout=100, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert "cannot write to standard output: No space left on device: the printed output is lost" in done.stderr
    assert done.stderr.count("lidarcodec: cannot") == 1
    assert (tmp_path / "out.mcap").exists() == whole
    if whole:
        assert run("info", tmp_path / "out.mcap").returncode == 0


@pytest.mark.sweep
def test_a_name_that_cannot_be_printed_is_no_failure(tmp_path: Path) -> None:
    """The recording was whole, and a script took it for failed."""
    out = os.fsencode(tmp_path) + b"/\xff.mcap"
    words = [sys.executable, "-m", "lidarcodec", "encode", "sim:city?frames=1", out]
    strict = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}
    result = subprocess.run(words, capture_output=True, env=strict, timeout=60, check=False)
    assert (result.returncode, b"\\udcff.mcap: 1 frame," in result.stdout) == (0, True), result.stderr
