"""What somebody who installs no extra would lose: the core works without them, and says which extra brings the rest."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from lidarcodec.codecs import table
from tests.command_line import environment, run_here

CORE = [name for name, entry in table.entries().items() if entry.extra is None]
EXTRAS = (
    "PIL", "alembic", "av", "cryptography", "cv2", "dpkt", "fastapi", "foxglove", "imagecodecs", "laspy", "matplotlib",
    "onnxruntime", "rosbags", "sqlalchemy", "starlette", "torch", "uvicorn",
)  # fmt: skip
"""Packages that no core install has."""
BARE = (
    "import json, sys\n"
    f"sys.modules |= dict.fromkeys({EXTRAS})\n"  # an import of None is a ModuleNotFoundError
    "from tests.command_line import run_here\n"
    "done = [run_here(*words) for words in json.loads(sys.argv[1])]\n"
    "print(json.dumps([[one.returncode, one.stdout, one.stderr] for one in done]))\n"
)


def bare(*commands):
    """Commands, one after the other, where no extra is installed: of each its exit code, and what it printed where."""
    words = json.dumps([[str(word) for word in command] for command in commands])
    done = subprocess.run(
        [sys.executable, "-c", BARE, words], capture_output=True, text=True, env=environment(), timeout=200, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    path = tmp_path_factory.mktemp("core") / "town.pcap"
    assert run_here("simulate", "sim:city", path, "--frames", 1).returncode == 0
    return path


def test_core_codecs_need_no_extra(capture, tmp_path):
    commands = []
    for codec in CORE:
        recording = tmp_path / f"{codec}.mcap"
        commands.append(("encode", capture, recording, "--codec", codec))
        commands.append(("decode", recording, tmp_path / f"{codec}.pcap"))
        commands.append(("verify", recording, capture, "--json"))
    done = bare(*commands)
    assert [one for one in done if one[0] != 0] == []
    assert all(json.loads(stdout)["packets_identical"] for _, stdout, _ in done[2::3])


def test_other_codecs_and_outputs_name_their_extra_and_auto_does_without(capture, tmp_path):
    others = {name: entry.extra for name, entry in table.entries().items() if entry.extra is not None}
    fine, *refused = bare(
        ("encode", capture, tmp_path / "auto.mcap", "--codec", "auto", "--set", "target_kbps=2000"),
        *(("encode", capture, tmp_path / "drive.mcap", "--codec", name) for name in others),
        ("decode", tmp_path / "auto.mcap", tmp_path / "cloud.las"),
        ("token", "list"),
    )
    assert fine[0] == 0, fine
    wanted = [(f"codec {name}", extra) for name, extra in others.items()]
    wanted += [(f"writing {tmp_path / 'cloud.las'}", "las"), ("the server", "server")]
    for (code, _, said), (what, extra) in zip(refused, wanted, strict=True):
        text = f"lidarcodec: {what} needs an optional dependency: pip install 'lidarcodec[{extra}]'\n"
        assert (code, said) == (2, text)
    assert [path.name for path in tmp_path.iterdir()] == ["auto.mcap"]


@pytest.mark.sweep
def test_a_recording_of_a_codec_that_is_not_there_names_its_extra(capture, tmp_path):
    recording = tmp_path / "drive.mcap"
    assert run_here("encode", capture, recording, "--codec", "h264").returncode == 0
    *refused, info = bare(
        ("decode", recording, tmp_path / "back.pcap"), ("bench", recording), ("info", recording)
    )  # fmt: skip
    for code, _, said in refused:
        assert (code, said.count("\n")) == (2, 1), said
        assert "codec h264 needs an optional dependency: pip install 'lidarcodec[video]'" in said
    assert info[0] == 0
    assert list(tmp_path.iterdir()) == [recording]


@pytest.mark.sweep
def test_info_lists_the_extras():
    ((code, stdout, _),) = bare(("info", "--json"))
    assert code == 0
    assert {"images", "video", "las", "server", "all"} <= json.loads(stdout)["extras"].keys()


@pytest.mark.sweep
def test_a_live_stream_of_a_codec_that_is_not_there_is_counted_and_says_why():
    program = (
        "import sys\n"
        "sys.modules |= dict.fromkeys(('av', 'imagecodecs'))\n"
        "from lidarcodec.apps.worker.isolation import Isolation\n"
        "from lidarcodec.codecs import table\n"
        "from lidarcodec.errors import MissingExtraError, UnsupportedVersionError\n"
        "from lidarcodec.settings import StreamSettings\n"
        "here = Isolation(None, print)\n"
        "for name in ('png', 'h264'):\n"
        "    try:\n"
        "        here.make_decoder(table.codec_id(name))\n"
        "    except UnsupportedVersionError as error:\n"
        "        print(error)\n"
        "    try:\n"
        "        here.make_encoder(StreamSettings(codec=name), 1)\n"
        "    except MissingExtraError as error:\n"
        "        print(error)\n"
        "print(table.codec('h264').settings.__name__, 'h264' in table.installed(), here.state())\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 5
    assert [line.partition(" needs ")[0] for line in lines[:4]] == [
        "decoding codec png",
        "codec png",
        "decoding codec h264",
        "codec h264",
    ]
    assert lines[4].startswith("H264Settings False")


@pytest.mark.sweep
def test_a_core_codec_imports_no_package_of_an_extra(capture, tmp_path):
    words = ("encode", capture, tmp_path / "drive.mcap", "--codec", "auto", "--set", "target_kbps=2000")
    command = [sys.executable, "-X", "importtime", "-m", "lidarcodec", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(), timeout=100, check=True)
    imported = {line.rpartition("|")[2].strip().partition(".")[0] for line in done.stderr.splitlines()}
    assert "numpy" in imported
    assert imported & set(EXTRAS) == set()
