"""What a user of `riddle` loses if another sensor than an HDL-64E drives: the gain, or the frames themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lidarcodec import wire
from lidarcodec.errors import DecodeError, MissingReferenceError
from lidarcodec.frame import Frame
from lidarcodec.message import SectionType
from lidarcodec.pipeline import StreamDecoder, frames_of
from lidarcodec.planes.beam_directions import BeamBook, beam_directions
from lidarcodec.sources import open_source
from tests.codecs.test_other_sensors_following import assert_same, messages_of

SENSORS = ("vlp16", "xt16")


def drive(sensor: str, count: int, options: str = "skip=30") -> list[Frame]:
    """Turns of a simulated drive."""
    with open_source(f"sim:city?sensor={sensor}&{options}&frames={count + 1}") as source:
        return list(frames_of(source.packets(), source.sensor, "revolution"))[:count]


@pytest.mark.parametrize("sensor", SENSORS)
def test_frames_of_a_drive_come_back_in_fewer_bytes(sensor: str, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = drive(sensor, 4)
    moved, decoder = messages_of(frames), StreamDecoder()
    for message, frame in zip(moved, frames, strict=True):
        assert_same(decoder.decode(message)[0], frame)
    monkeypatch.setattr(BeamBook, "of", lambda *_: None)
    still = messages_of(frames)
    sizes = [[len(wire.pack(message)) for message in of] for of in (moved, still)]
    assert sizes[0][3] < 0.985 * sizes[1][3]


def test_a_drive_with_a_bound_keeps_the_bound() -> None:
    frames, decoder = drive("vlp16", 3), StreamDecoder()
    for message, frame in zip(messages_of(frames, max_error_m=0.05), frames, strict=True):
        (decoded,) = decoder.decode(message)
        off = np.abs(decoded.range.astype(np.int64) - frame.range.astype(np.int64))
        assert off.max() * frame.sensor.range_step_m <= 0.05
        np.testing.assert_array_equal(decoded.range > 0, frame.range > 0)


def test_a_lost_message_of_a_drive_is_noticed_and_a_key_message_goes_on() -> None:
    frames = drive("vlp16", 5)
    messages, decoder = messages_of(frames, key_interval=4), StreamDecoder()
    assert_same(decoder.decode(messages[0])[0], frames[0])
    with pytest.raises(MissingReferenceError, match="needs frame 1"):
        decoder.decode(messages[2])
    assert_same(decoder.decode(messages[4])[0], frames[4])


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.999])
def test_a_cut_message_of_a_drive_shows_no_false_picture_after_it(share: float) -> None:
    frames = drive("vlp16", 4)
    messages, decoder = messages_of(frames, key_interval=3), StreamDecoder()
    decoder.decode(messages[0])
    cut = tuple(
        one._replace(data=one.data[: int(share * len(one.data))]) if one.type == SectionType.PLANES else one
        for one in messages[1].sections
    )
    with pytest.raises(DecodeError):
        decoder.decode(replace(messages[1], sections=cut))
    with pytest.raises(MissingReferenceError):
        decoder.decode(messages[2])
    assert_same(decoder.decode(messages[3])[0], frames[3])


@pytest.mark.parametrize("sensor", ["vlp16", "xt32", "vls128", "os1-32"])
def test_beams_look_where_the_points_are(sensor: str) -> None:
    (frame,) = drive(sensor, 1)
    beams = beam_directions(frame)
    assert beams is not None
    assert beams.shape == (frame.sensor.rows, 2)
    assert (np.diff(beams[:, 0]) < 0).all()
    cloud = frame.cloud()
    near = np.hypot(cloud["x"], cloud["y"]) > 5
    up = np.degrees(np.arctan2(cloud["z"], np.hypot(cloud["x"], cloud["y"])))[near]
    off = np.abs(up - beams[cloud["ring"][near], 0] * 360 / (1 << 20))
    assert float(off.max()) < 0.6  # beams begin some centimetres beside the origin
