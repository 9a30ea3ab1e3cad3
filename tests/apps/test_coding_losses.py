"""What coding took from a live stream is said at its end, as `info` says it of a recording of the same messages."""

from __future__ import annotations

import pytest

import lidarcodec
from lidarcodec.apps.demo.demo import EXACT, Demo
from lidarcodec.apps.receiver.live_stream import LiveStream
from lidarcodec.commands.info.recording import inspect_recording
from lidarcodec.evaluation.coding_losses import CodingLosses
from lidarcodec.pipeline import StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack
from tests.apps.in_memory import KEY, publisher
from tests.transport.test_contract import eventually


@pytest.fixture(scope="module")
def frames():
    return list(lidarcodec.read_frames("sim:road?frames=2"))


def coded(frames, *settings):
    """The messages of frames, one after the other with each of the settings."""
    encoder = StreamEncoder(settings[0])
    messages = []
    for one in settings:
        encoder.apply(one)
        messages += [pack(message) for frame in frames for message in encoder.encode(frame)]
    return messages


def losses_of(messages):
    losses = CodingLosses()
    for data in messages:
        losses.came(data)
    return losses


def test_a_lossless_stream_has_lost_nothing(frames):
    losses = losses_of(coded(frames, StreamSettings(codec="pcodec")))
    assert losses.text() == ""
    assert losses.values()["largest_bound_m"] == 0


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"max_error_m": 0.02}, ", ranges off by at most 0.02 m"),
        ({"max_error_m": 1.236}, ", ranges off by at most 1.236 m"),
        ({"intensity": "off"}, ", intensities left out"),
        ({"intensity": "error=2"}, ", intensities in few values"),
        ({"codec": "png", "max_error_m": 0.05}, ", ranges off by at most 0.05 m"),
        ({"codec": "jpeg"}, ", ranges off by no known bound"),
        ({"codec": "raw"}, ", intensities not said to be whole"),
        ({"base_error_m": 0.05}, ", ranges off by at most 0.05 m"),
    ],
)  # fmt: skip
def test_every_loss_is_named(frames, settings, text):
    settings = {"codec": "pcodec", **settings}
    assert text in losses_of(coded(frames[:1], StreamSettings(**settings))).text()


def test_a_bound_that_no_status_told_counts(frames):
    """A target moves the bound between two statuses: the summary promised 0.038 m, and ranges were off by 0.042."""
    steps = [StreamSettings(codec="pcodec", max_error_m=one) for one in (0.02, 0.088, 0.04)]
    losses = losses_of(coded(frames, *steps))
    losses.told({"settings": steps[-1].model_dump(), "codec": "pcodec", "rate": {"max_error_m": 0.04}})
    assert losses.text() == ", ranges off by at most 0.088 m"
    off = [StreamSettings(codec="pcodec", intensity=one) for one in ("lossless", "off", "levels=3")]
    assert losses_of(coded(frames, *off)).text() == ", intensities left out in 2 and in few values in 2 of 6 frames"
    some = coded(frames, StreamSettings(codec="pcodec", max_error_m=0.02)) + coded(frames, StreamSettings(codec="jpeg"))
    assert losses_of(some).text().startswith(", ranges off by at most 0.02 m, in 2 frames by no known bound")


def test_bounds_are_told_in_the_steps_of_the_sensor_also_of_messages_before_a_key():
    frames = lidarcodec.read_frames("sim:road?sensor=os1-64&frames=2")
    messages = coded(list(frames), StreamSettings(codec="pcodec", max_error_m=0.003))
    assert losses_of(messages[::-1]).values()["largest_bound_m"] == 0.003
    other = lidarcodec.read_frames("sim:road?sensor=vlp16&frames=2")  # with steps of 2 mm
    messages += coded(list(other), StreamSettings(codec="pcodec", max_error_m=0.004))
    assert losses_of(messages).values()["largest_bound_m"] == 0.004


def test_a_reduction_for_a_part_of_the_time_is_not_told_for_all_of_it(frames):
    """Of a stream whose settings had changed the summary said 7.8 % of the returns, where 76 % had come."""
    messages = coded(frames, StreamSettings(codec="pcodec")) * 4
    messages += coded(frames, StreamSettings(codec="pcodec", reduction="random", keep_fraction=0.1))
    losses = losses_of(messages)
    losses.told({"reduction": {"name": "random", "returns": 2000, "kept": 200}})
    assert losses.values()["returns_percent"] == pytest.approx(82)
    assert losses.text() == ", about 82.0 % of the returns sent"
    raw = losses_of(coded(frames, StreamSettings(codec="raw", reduction="random", keep_fraction=0.1)))
    raw.told({"reduction": {"name": "random", "returns": 2000, "kept": 200}})
    assert raw.values()["returns_percent"] == pytest.approx(10)


def test_a_status_or_a_message_that_makes_no_sense_is_no_error():
    losses = losses_of([b"", b"\x93LDR", b"of no version"])
    for status in (None, {}, {"reduction": []}, {"reduction": {"returns": "all"}}):
        losses.told(status)
    assert losses.text() == ""


@pytest.mark.parametrize(
    "settings",
    [{"reduction": "lattice:4"}, {"codec": "raw"}, {"codec": "jpeg"}, {"base_error_m": 0.05}, {"framing": "parts:4"}],
    ids=str,
)
def test_the_summary_says_what_the_recording_says(network, tmp_path, settings):
    losses, chosen = CodingLosses(), StreamSettings(**{"codec": "pcodec", **settings})
    with (
        publisher(network, None, chosen),
        LiveStream(KEY, transport=network.end(), record=tmp_path, on_message=losses.came) as stream,
    ):
        assert eventually(lambda: stream.status is not None)
        for _ in range(3):
            stream.next(60)
            losses.told(stream.status)
    found = inspect_recording(next(tmp_path.glob("*.mcap")))["sent"]
    values = losses.values()
    if "lattice:4" in settings.values():
        assert values["returns_percent"] == pytest.approx(25, abs=1)
        assert losses.text().startswith(", about 25.")
    values.pop("returns_percent")
    assert values == found


def test_the_demonstration_does_not_call_a_stream_exact_that_is_not(network):
    """With a target its summary said "packets are restored byte for byte", as no bound was set."""
    demo, chosen = Demo("sim:road", 1, []), StreamSettings(codec="pcodec", target_kbps=300)
    listening = LiveStream(KEY, transport=network.end(), on_message=demo.losses.came)
    with publisher(network, None, chosen), listening as stream:
        for _ in range(3):
            stream.next(60)
        assert demo.figures(stream).fidelity == demo.losses.text().removeprefix(", ") != EXACT
