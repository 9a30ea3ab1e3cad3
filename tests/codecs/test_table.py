"""The table of codecs, and the settings that an operator may get wrong."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

import lidarcodec.codecs
from lidarcodec.codecs import base, table
from lidarcodec.codecs.base import CodecSettings, own_settings
from lidarcodec.errors import SettingsError, UnknownNameError, UnsupportedVersionError
from lidarcodec.settings import StreamSettings
from tests.contracts import frames


def test_numbers_stay_what_they_are() -> None:
    """They stand in every recording."""
    assert {name: table.codec_id(name) for name in ("raw", "zstd", "pcodec")} == {"raw": 1, "zstd": 2, "pcodec": 3}
    for name in table.names():
        number = table.codec_id(name)
        assert table.codec_name(number) == name, f"{name} and {table.codec_name(number)} have the number {number}"


def test_every_codec_file_is_in_the_table() -> None:
    folder = Path(lidarcodec.codecs.__file__).parent
    files = {path.stem for path in folder.glob("*.py") if re.search(r"^CODEC = ", path.read_text(), re.M)}
    named = {name.replace("-", "_") for name in table.names()}
    assert named - files == set(), f"codecs without a file of their name in {folder.name}/ that has CODEC"
    assert files - named == set(), "files with a CODEC that codecs/table.py does not name"


def test_every_codec_describes_its_settings() -> None:
    for name in table.names():
        model = table.codec(name).settings
        assert issubclass(model, CodecSettings)
        assert model.model_config["extra"] == "forbid"
        model()


def test_unknown_codecs_are_named() -> None:
    for ask in (table.codec_id, table.codec, lambda name: table.check(StreamSettings(codec=name))):
        with pytest.raises(UnknownNameError, match="draco"):
            ask("draco")
    for ask in (table.codec_name, table.make_decoder):
        with pytest.raises(UnsupportedVersionError, match="250"):
            ask(250)


@pytest.mark.parametrize(
    ("settings", "field", "says"),
    [
        (
            {"codec_settings": {"quality": 9}},
            "codec_settings.quality",
            "codec pcodec has no setting 'quality': choose one of level",
        ),
        ({"codec_settings": {"level": 0}}, "codec_settings.level", "level"),
        ({"codec_settings": {"level": "high"}}, "codec_settings.level", "level"),
        ({"codec": "raw", "codec_settings": {"level": 3}}, "codec_settings.level", "has no settings"),
        ({"codec": "zstd", "codec_settings": {"level": 20}}, "codec_settings.level", "19"),
        (
            {"codec": "raw", "target_kbps": 3000},
            "target_kbps",
            "raw cannot keep a target bitrate: .* choose one of zstd",
        ),
        (
            {"codec": "raw", "target_kbps": "auto"},
            "target_kbps",
            "raw cannot keep a target bitrate: .* choose one of zstd",
        ),
    ],
)
def test_settings_that_cannot_be_followed_say_why(settings: dict[str, object], field: str, says: str) -> None:
    with pytest.raises(SettingsError, match=says) as caught:
        table.make_encoder(StreamSettings(**settings), 1)
    assert caught.value.field == field


def test_settings_that_can_be_followed() -> None:
    for name in table.names():
        settings = StreamSettings(codec=name)
        assert table.check(settings) is settings
    assert table.check(StreamSettings(max_error_m=0.02, codec_settings={"level": 12}))


@pytest.mark.parametrize("name", table.installed())
def test_own_settings_are_checked_when_they_are_taken_and_not_with_each_frame(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks: list[str] = []

    def counted(model: type[CodecSettings], settings: StreamSettings) -> CodecSettings:
        checks.append(settings.codec)
        return own_settings(model, settings)

    monkeypatch.setattr(base, "own_settings", counted)
    encoder = table.make_encoder(StreamSettings(codec=name), 1)
    checks.clear()
    for index in range(3):
        encoder.encode(frames.scene(4).with_(index=index))
        encoder.apply(StreamSettings(codec=name, key_interval=7 + index))
    encoder.flush()
    assert checks == []


def test_an_encoder_stays_the_codec_that_it_is() -> None:
    encoder = table.make_encoder(StreamSettings(), 1)
    with pytest.raises(SettingsError, match="cannot change to codec raw"):
        encoder.apply(StreamSettings(codec="raw"))


def test_modules_are_imported_on_first_use() -> None:
    assert import_module("lidarcodec.codecs.pcodec").CODEC is table.codec("pcodec")
