"""A stream with `codec=auto`: it begins at once, then changes to the codec that shows most and keeps up here."""

from __future__ import annotations

import threading

import pytest

from lidarcodec.apps.publisher.choosing import CodecChooser, encode_ms
from lidarcodec.codecs import table
from lidarcodec.errors import SettingsError
from lidarcodec.ratecontrol import second_look
from lidarcodec.ratecontrol.choosing import ranked
from lidarcodec.settings import StreamSettings
from tests.apps.in_memory import live, publisher
from tests.transport.test_contract import eventually

AUTO = StreamSettings(codec="auto", target_kbps=4000)
PLENTY_S, NONE_S = 10.0, 1e-9
"""Of a packet: time enough for any codec, and for none."""


def frame_of_a_drive():
    from lidarcodec import api

    return next(iter(api.read_frames("sim:road?seed=2&frames=1")))


def chosen_with(interval_s, frame):
    told = []
    chooser = CodecChooser(interval_s)
    chooser.when_chosen(lambda settings, codec: told.append((settings, codec, threading.current_thread())))
    now = chooser.codec_for(AUTO)
    assert now.codec == "pcodec", "nobody waits"
    assert chooser.state(now.codec)["because"] == "until one of the next frames has decided"
    chooser.offer(frame)
    assert eventually(lambda: bool(told), 60)
    chooser.close()
    assert told[0][2] is not threading.current_thread(), "the encoder goes on meanwhile"
    return chooser, told[0][1]


@pytest.mark.sweep
def test_the_best_codec_is_taken_where_there_is_time_and_the_quickest_where_there_is_none():
    frame = frame_of_a_drive()
    chooser, codec = chosen_with(PLENTY_S, frame)
    assert codec == ranked(AUTO)[0]
    state = chooser.state(codec)
    assert state["codec"] == codec
    assert list(state["encode_ms"]) == [codec], "no other one had to be tried"
    chooser, codec = chosen_with(NONE_S, frame)
    state = chooser.state(codec)
    assert codec == min(state["encode_ms"], key=state["encode_ms"].get)
    assert list(state["encode_ms"]) == list(ranked(AUTO)), "a slow processor needs one of the last ones"
    assert all(name in state["because"] for name in ranked(AUTO)), "it is said of which it is the fastest"
    assert "no codec encodes a frame within" in state["because"]


def test_frames_that_a_target_leaves_out_do_not_make_a_codec_look_quick():
    """They cost nothing, so a codec that cannot keep up would be taken."""
    frame = frame_of_a_drive()
    lossless = {"codec": "riddle", "max_error_m": 0, "intensity": "lossless", "reduction": "all"}
    all_sent = encode_ms(StreamSettings(**lossless), frame, 1e9)
    hardly_any_sent = encode_ms(StreamSettings(**lossless, target_kbps=300), frame, 1e9)
    assert hardly_any_sent > all_sent / 4


def test_what_was_decided_holds_until_other_settings_ask_anew():
    frame = frame_of_a_drive()
    chooser, codec = chosen_with(PLENTY_S, frame)
    assert chooser.codec_for(AUTO.changed(follow="somebody"), "pcodec").codec == codec
    again = chooser.codec_for(AUTO.changed(target_kbps=500), "predictive")
    assert again.codec == "predictive", "what is in force stays until it is decided"
    assert chooser.codec_for(StreamSettings(codec="zstd")).codec == "zstd"
    assert chooser.state("zstd") is None, "nothing was chosen: it was named"


def test_the_choice_is_made_again_when_the_machine_is_quicker_and_when_it_is_slower(monkeypatch):
    monkeypatch.setattr(second_look, "FIRST_S", 0.0)
    monkeypatch.setattr(second_look, "LASTS_S", 0.0)
    frame = frame_of_a_drive()
    told = []
    chooser = CodecChooser(NONE_S)
    chooser.when_chosen(lambda settings, codec: told.append(codec))
    chooser.codec_for(AUTO)
    chooser.offer(frame)
    assert eventually(lambda: bool(told), 60)
    chooser._interval_s = PLENTY_S  # what kept the processor busy has ended
    assert eventually(lambda: chooser.offer(frame) or told[-1] == ranked(AUTO)[0], 60)
    assert chooser.state(told[-1])["because"].startswith("gives the best picture")
    chooser._thread.join()
    chooser.offer(frame)
    assert not chooser._thread.is_alive(), "nothing has changed since"
    before = len(told)
    chooser.encoded(1e12)
    chooser.offer(frame)
    assert eventually(lambda: len(told) > before, 60), "this codec has become too slow"
    chooser.close()


def test_a_stream_says_which_codec_it_chose_and_is_decoded_all_the_way(network):
    with publisher(network, None, AUTO, rate=10.0) as car, live(network) as stream:
        assert stream.next(60)
        assert eventually(lambda: car.status()["codec_choice"]["budget_ms"] is not None)
        status = car.status()
        assert status["settings"]["codec"] == car.settings.codec == "auto"
        assert status["codec_choice"]["codec"] == status["codec"]
        assert set(status["codec_choice"]["encode_ms"]) <= set(table.names())
        for change in ({"codec": "zstd"}, {"codec": "auto", "max_error_m": 0.02}, {"target_kbps": 900}):
            applied = car.change(**change)
            assert applied.settings.codec == change.get("codec", "auto")
            assert (car.status()["codec_choice"] is None) == (applied.settings.codec != "auto")
            for _ in range(5):
                assert stream.next(60)
        assert eventually(lambda: car.status()["codec_choice"]["budget_ms"] is not None)
        assert car.status()["codec"] in ranked(car.settings)
        assert stream.next(60)
        assert stream.summary()["errors"] == {}


def test_settings_that_are_refused_leave_the_choice_as_it_was(network):
    with publisher(network, None, AUTO) as car:
        with pytest.raises(SettingsError, match="codec auto has no settings"):
            car.change(codec_settings={"effort": 2})
        assert car.settings.codec == "auto"
        assert car.status()["codec_choice"] is not None
