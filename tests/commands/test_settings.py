"""`--set` is how users reach every setting: a key that lands in the wrong place, or nowhere, would go unnoticed."""

import pytest

from lidarcodec.commands.settings import one_setting, sweep
from lidarcodec.errors import SettingsError, UnknownNameError
from lidarcodec.ratecontrol.presets import preset


def test_a_field_of_the_stream_goes_to_the_stream_and_another_to_the_codec():
    settings = one_setting("zstd", ["max_error_m=0.01", "level=9"])
    assert settings.codec == "zstd"
    assert settings.max_error_m == 0.01
    assert settings.codec_settings == {"level": 9}


def test_values_are_json_scalars_and_anything_else_is_text():
    settings = one_setting(None, ["intensity=levels=16", "max_error_m=null", "framing=packets:29"])
    assert settings.intensity == "levels=16"
    assert settings.max_error_m is None
    assert settings.framing == "packets:29"


@pytest.mark.parametrize(("text", "value"), [(".02", 0.02), ("2.", 2.0), ("+0.5", 0.5), ("1e-2", 0.01), ("2.E-1", 0.2)])
def test_numbers_may_be_written_short(text, value):
    assert one_setting(None, [f"max_error_m={text}"]).max_error_m == value


@pytest.mark.parametrize("pair", ["level=[1,2]", 'level={"a":1}', "level=nine", "level=NaN"])
def test_a_value_of_the_wrong_kind_is_refused_with_its_key(pair):
    with pytest.raises(SettingsError, match="level"):
        one_setting("zstd", [pair])


def test_an_unknown_key_is_refused_by_name_and_the_known_ones_are_listed():
    with pytest.raises(SettingsError, match=r"unknown setting 'colour': choose one of level,.* codec, .*max_error_m"):
        one_setting("pcodec", ["colour=red"])
    with pytest.raises(SettingsError, match=r"'max_eror_m': did you mean max_error_m\?"):
        one_setting("pcodec", ["max_eror_m=1"])


def test_a_setting_that_is_a_text_may_look_like_a_number():
    assert one_setting(None, ["follow=7"]).follow == "7"
    assert one_setting(None, ["follow=null"]).follow is None


@pytest.mark.parametrize("pair", ["level", "=3", ""])
def test_what_is_no_pair_is_refused(pair):
    with pytest.raises(SettingsError, match="key=value"):
        one_setting("zstd", [pair])


def test_a_key_given_twice_is_refused_instead_of_the_last_one_winning():
    with pytest.raises(SettingsError, match="twice"):
        one_setting("zstd", ["level=3", "level=9"])
    with pytest.raises(SettingsError, match="twice"):
        one_setting("zstd", ["codec=pcodec"])


def test_of_a_link_only_what_is_in_force_is_told():
    """`--link 1mbit --codec pcodec` said codec=auto."""
    assert preset("1mbit").told(one_setting(None, [], "1mbit")) == "purpose=look, codec=auto, target_kbps=800"
    told = preset("1mbit").told(one_setting("pcodec", ["target_kbps=500"], "1mbit"))
    assert told == "purpose=look; codec=pcodec, target_kbps=500 are used, as given"


def test_a_link_in_the_way_of_two_layers_is_named():
    with pytest.raises(SettingsError, match="--link 1mbit sets target_kbps=800: leave out --link"):
        one_setting("pcodec", ["base_error_m=0.05"], link="1mbit")
    given = one_setting("pcodec", ["base_error_m=0.05", "target_kbps=null"], link="1mbit")
    assert (given.base_error_m, given.target_kbps) == (0.05, None)


def test_an_unknown_codec_names_those_there_are():
    with pytest.raises(UnknownNameError, match="choose one of raw, zstd, pcodec"):
        one_setting("mp3", [])


def test_a_sweep_is_every_combination_in_order():
    found = sweep("zstd,pcodec", ["max_error_m=0,0.02", "framing=packets:29,revolution"])
    assert [(s.codec, s.max_error_m, s.framing) for s in found] == [
        (codec, bound, framing)
        for codec in ("zstd", "pcodec")
        for bound in (0, 0.02)
        for framing in ("packets:29", "revolution")
    ]


def test_one_bad_value_of_a_sweep_is_refused_before_anything_is_measured():
    with pytest.raises(SettingsError, match="max_error_m"):
        sweep("zstd", ["max_error_m=0,-1"])


@pytest.mark.parametrize("pair", ["max_error_m=true", "key_interval=true", "level=true"])
def test_true_is_no_number_where_it_would_mean_a_metre(pair):
    with pytest.raises(SettingsError, match=pair.partition("=")[0]):
        one_setting("zstd", [pair])


@pytest.mark.parametrize("pair", ["framing=packets:١٢", "intensity=levels=٣٣", "intensity=error=٣"])
def test_digits_are_those_of_ascii(pair):
    with pytest.raises(SettingsError):
        one_setting(None, [pair])


@pytest.mark.parametrize(
    "choice", ["error=0", "error=128", "error=", "error=-1", "levels=1", "levels=257", "levels=1.5"]
)
def test_intensities_beyond_the_limits_are_refused_with_what_is_possible(choice):
    with pytest.raises(SettingsError, match="error=N with N from 1 to 127, or levels=N with N from 2 to 256"):
        one_setting(None, [f"intensity={choice}"])


def test_an_error_of_intensities_is_kept_and_told_as_levels_too():
    settings = one_setting(None, ["intensity=error=4"])
    assert (settings.intensity_error, settings.intensity_levels) == (4, 29)
    assert one_setting(None, ["intensity=error=127"]).intensity_levels == 2
    assert one_setting(None, ["intensity=levels=9"]).intensity_error == 0


@pytest.mark.parametrize("names", ["zstd,", ",zstd", "zstd,,raw", ","])
def test_a_missing_name_in_a_list_of_codecs_is_not_taken_for_the_default(names):
    with pytest.raises(SettingsError, match="comma"):
        sweep(names, [])


def test_a_link_gives_what_is_not_given_otherwise():
    assert one_setting(None, [], "2mbit").model_dump(include={"codec", "purpose", "target_kbps"}) == {
        "codec": "auto", "purpose": "look", "target_kbps": 1600.0,
    }  # fmt: skip
    other = one_setting("zstd", ["target_kbps=500", "level=9", "intensity=off"], "2mbit")
    assert (other.codec, other.target_kbps, other.intensity, other.codec_settings) == ("zstd", 500, "off", {"level": 9})
    assert one_setting(None, [], "lan").target_kbps is None
    with pytest.raises(SettingsError, match="--link must be one of 1mbit"):
        one_setting(None, [], "fast")
