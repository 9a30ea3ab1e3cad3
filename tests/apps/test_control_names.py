"""What may be said over the network opens no file by its path."""

import pytest

from lidarcodec.apps.control import settings_with
from lidarcodec.codecs.riddle_shelf import weights_of
from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.settings import StreamSettings

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
