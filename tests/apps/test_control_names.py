"""What may be said over the network opens no file by its path."""

import pytest

from lidarcodec.apps.control import settings_with
from lidarcodec.apps.worker import process
from lidarcodec.commands.publish import config as publish_config
from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.network.shelf import FOLDER_VARIABLE, look_in, weights_of
from lidarcodec.settings import StreamSettings
from tests.command_line import run_here

RIDDLE = StreamSettings(codec="riddle")


def refusal(value, settings=RIDDLE):
    with pytest.raises(SettingsError) as caught:
        settings_with(settings, {"codec_settings": {"weights": value}})
    return str(caught.value)


def test_a_path_is_refused_with_one_message_whether_there_is_such_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here.lcrw").write_bytes(b"LCRW")
    paths = ["/etc/shadow", "/etc/none", "../x", "here.lcrw", "none.lcrw", str(tmp_path / "here.lcrw"), "a\0b", "~/x"]
    assert len({refusal(path) for path in paths}) == 1
    assert "command line" in refusal(paths[0])


def test_a_path_in_force_may_be_said_again():
    local = StreamSettings(codec="riddle", codec_settings={"weights": "/opt/mine.lcrw", "effort": 1})
    values = {"weights": "/opt/mine.lcrw", "effort": 1, "memory": False}
    assert settings_with(local, {"codec_settings": values}).codec_settings["weights"] == "/opt/mine.lcrw"
    refusal("/opt/other.lcrw", local)


def test_a_name_is_of_the_package_or_of_the_folder_that_was_named(tmp_path, monkeypatch):
    assert weights_of("riddle-sim").name == weights_of("").name
    monkeypatch.delenv("LIDARCODEC_WEIGHTS_DIR", raising=False)
    with pytest.raises(UnknownNameError, match="riddle-sim"):
        weights_of("mine")
    (tmp_path / "mine.lcrw").write_bytes(weights_of("").data)
    monkeypatch.setenv("LIDARCODEC_WEIGHTS_DIR", str(tmp_path))
    assert weights_of("mine").name == weights_of("").name


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with weights `mine`; the environment is as it was afterwards."""
    monkeypatch.setenv(FOLDER_VARIABLE, "/nowhere")
    made = tmp_path / "weights"
    made.mkdir()
    (made / "mine.lcrw").write_bytes(weights_of("").data)
    return made


def test_publish_takes_names_from_the_folder_of_weights_dir(folder, tmp_path):
    words = ("publish", "sim:city?frames=2", "--rate", "100", "--codec", "riddle", "--weights-dir", folder)
    done = run_here(*words, "--set", "weights=mine")
    assert done.returncode == 0, done.stderr
    done = run_here(*words, "--set", "weights=other")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "unknown weights 'other': choose one of mine, riddle-sim" in done.stderr
    done = run_here(*words[:-1], tmp_path / "none", "--set", "weights=mine")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert f"there is no folder {tmp_path / 'none'}" in done.stderr


def config(weights, folder=None):
    return f"""
{f"weights_dir: {folder}" if folder else ""}
sensors:
  - {{name: roof, source: "sim:city", codec: riddle, settings: {{weights: {weights}}}}}
"""


def test_a_config_file_names_the_folder_and_the_command_line_wins(folder, tmp_path):
    assert publish_config.parse(config("mine", folder), "a.yaml").weights_dir == folder
    publish_config.parse(config("mine", tmp_path / "none"), "a.yaml", folder)
    (tmp_path / "a.yaml").write_text(config("other", folder))
    done = run_here("publish", "--config", tmp_path / "a.yaml")
    assert done.returncode == 2
    assert "a.yaml: sensors.0.settings: unknown weights 'other': choose one of mine, riddle-sim" in done.stderr
    with pytest.raises(SettingsError, match=r"a\.yaml: weights_dir: there is no folder"):
        publish_config.parse(config("mine", tmp_path / "none"), "a.yaml")
    with pytest.raises(SettingsError, match="weights_dir: Input"):
        publish_config.parse(config("riddle-sim", "[1]"), "a.yaml")


def test_a_folder_is_told_to_the_process_that_codes(folder):
    look_in(folder)
    assert process._environment()[FOLDER_VARIABLE] == str(folder)
    assert settings_with(RIDDLE, {"codec_settings": {"weights": "mine"}}).codec_settings["weights"] == "mine"


@pytest.mark.parametrize(
    ("field", "said"),
    [
        ("codec: riddle, settings: {weights: /none/a.lcrw}", "settings: cannot read the weights /none/a.lcrw"),
        ("calibration: /none/db.xml", "calibration: cannot read calibration /none/db.xml"),
        ("poses: /none/poses.txt", "poses: cannot read poses from /none/poses.txt"),
        ("source: 'tcp://here'", "source: unknown kind of source 'tcp'"),
    ],
)
def test_what_a_config_file_names_is_tried_before_anything_starts(tmp_path, field, said):
    """A service with a wrong name was restarted for ever, and its other sensors with it."""
    source = "" if field.startswith("source") else "source: 'sim:city', "
    text = f"sensors:\n  - {{name: front, source: 'sim:city'}}\n  - {{name: roof, {source}{field}}}\n"
    (tmp_path / "a.yaml").write_text(text)
    done = run_here("publish", "--config", tmp_path / "a.yaml")
    assert done.returncode == 2, done.stderr
    assert f"a.yaml: sensors.1.{said}" in done.stderr
    assert done.stdout == ""
