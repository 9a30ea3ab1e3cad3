"""Some of what a live stream sends and records is decoded again: failures are counted and said, and nobody waits."""

from __future__ import annotations

import logging
import time

import pytest

from lidarcodec.apps import spot_check
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.receiver.live_stream import subscribe
from lidarcodec.apps.recorder import Record
from lidarcodec.apps.spot_check import WAITING, SpotCheck
from lidarcodec.codecs import pcodec
from lidarcodec.frame import Frame
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import StreamSettings, settings_from
from lidarcodec.transport.memory import MemoryNetwork
from tests.apps.streams import Loop
from tests.contracts import frames
from tests.transport.test_contract import eventually

FRAMES = [frames.scene(2, index=index) for index in range(30)]


def offer(check: SpotCheck, encoder: StreamEncoder, sent: list[Frame], keys: tuple[int, ...] = ()) -> None:
    """Give all frames and their messages."""
    for frame in sent:
        messages = encoder.encode(frame, key=frame.index in keys)
        check.offer(encoder.reduced or frame, encoder.settings, messages)
        assert eventually(lambda: not check._queue)


@pytest.mark.parametrize(
    "values",
    [
        {"codec": "pcodec", "max_error_m": 0.05},
        {"codec": "predictive", "codec_settings": {"motion": True}},
        {"codec": "riddle", "reduction": "random", "keep_fraction": 0.3},
        {"codec": "jpeg-layered", "intensity": "levels=8"},
    ],
)
def test_a_run_goes_from_a_key_message_on(values: dict[str, object]) -> None:
    check, encoder = SpotCheck("sent"), StreamEncoder(settings_from(values))
    encoder.encode(FRAMES[0])
    offer(check, encoder, FRAMES[1:], keys=(5,))
    check.close()
    assert check.counts["sent wrong"] == 0
    assert 10 <= check.counts["sent checked"] <= 25


def test_it_rests_when_it_took_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spot_check, "RUN_S", 1e-6)
    check, encoder = SpotCheck("sent"), StreamEncoder(StreamSettings(codec="zstd", key_interval=1))
    offer(check, encoder, FRAMES[:1])
    assert eventually(lambda: not check._following)
    monkeypatch.setattr(check, "_rest_until", time.monotonic() + 60)
    offer(check, encoder, FRAMES[1:])
    assert check.counts["sent checked"] == 1
    monkeypatch.setattr(check, "_rest_until", 0.0)
    offer(check, encoder, FRAMES[:1])
    check.close()
    assert check.counts["sent checked"] == 2


def test_what_it_cannot_take_in_time_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    check, encoder = SpotCheck("sent"), StreamEncoder(StreamSettings(codec="zstd"))
    held = check._held
    monkeypatch.setattr(check, "_held", lambda item: bool(time.sleep(0.3)) or held(item))
    for frame in FRAMES:
        check.offer(frame, encoder.settings, encoder.encode(frame))
    assert len(check._queue) <= WAITING
    check.close()
    assert check.counts["sent wrong"] == 0


def test_other_settings_end_a_run_and_a_codec_with_a_process_of_its_own_begins_none() -> None:
    check, encoder = SpotCheck("sent"), StreamEncoder(StreamSettings(codec="jpeg-layered"))
    offer(check, encoder, FRAMES[:11])
    encoder.apply(StreamSettings(codec="jpeg-layered", intensity="off"))
    offer(check, encoder, FRAMES[11:20])
    encoder.apply(StreamSettings(codec="h264"))
    before = check.counts.total()
    offer(check, encoder, FRAMES[20:])
    check.close()
    assert check.counts == {"sent checked": before}


def test_what_is_wrong_is_counted_and_said_once(monkeypatch, caplog) -> None:
    monkeypatch.setattr(spot_check, "SHARE", 1e6)
    quantise = pcodec.quantise
    monkeypatch.setattr(pcodec, "quantise", lambda values, step: quantise(values, step) // 2)
    check, encoder = SpotCheck("recorded"), StreamEncoder(StreamSettings(codec="pcodec", key_interval=1))
    with caplog.at_level(logging.WARNING):
        for number, frame in enumerate(FRAMES[:5], 1):
            offer(check, encoder, [frame])
            assert eventually(lambda number=number: check.counts["recorded wrong"] == number and not check._following)
        check.close()
        check.close()
    first, last = (record.message for record in caplog.records)
    assert first.startswith("recorded: pcodec did not keep frame 0: it was decoded with a range")
    assert last == "recorded: of the checked frames, 5 were wrong after decoding and 0 were right"


def test_a_publisher_that_records_checks_what_it_records_and_what_it_sends(tmp_path) -> None:
    network = MemoryNetwork()
    with (
        network.transport() as near,
        network.transport() as far,
        subscribe("vehicle/lidar", transport=far, newest=False, until_end=True) as stream,
    ):
        settings = StreamSettings(max_error_m=0.1, intensity="off")
        car = Publisher(Loop(6), settings, transport=near, rate="max", record=Record(tmp_path, "lossless"))
        with car:
            assert sum(1 for _ in stream) == 6
        counts = car.status()["recording"]["counts"]
    assert counts["sent checked"] > 0
    assert counts["recorded checked"] > 0
    assert "sent wrong" not in counts
    assert "recorded wrong" not in counts
