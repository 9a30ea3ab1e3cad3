"""Without these a sensor is drawn, merged or published where it does not sit."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidarcodec.errors import LidarCodecError, SectionError, SettingsError
from lidarcodec.frame import Frame
from lidarcodec.message import Message, Section, SectionType
from lidarcodec.mounting import MOST_M, SECTION_BYTES, Mounting, decode_mount, encode_mount, vehicle_pose
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.settings import StreamSettings
from lidarcodec.wire import pack, unpack
from tests.contracts import frames
from tests.sensors.made_frames import made_frames, made_layouts

ROOF = Mounting(1.5, -0.2, 1.8, 1.0, -2.0, 90.0)
FRONT = Mounting(3.2, 0.0, 0.6)
metres = st.floats(-MOST_M, MOST_M)
degrees = st.floats(-360, 360)


@given(metres, metres, metres, degrees, degrees, degrees)
def test_six_numbers_and_their_matrix_say_the_same(x, y, z, roll, pitch, yaw) -> None:
    one = Mounting(x, y, z, roll, pitch, yaw)
    again = Mounting.of_matrix(one.T_vehicle_sensor)
    np.testing.assert_allclose(again.T_vehicle_sensor, one.T_vehicle_sensor, atol=1e-7)
    np.testing.assert_allclose(Mounting.parse(str(one)).T_vehicle_sensor, one.T_vehicle_sensor, atol=1e-7)
    np.testing.assert_array_equal(decode_mount(encode_mount(one.T_vehicle_sensor)), one.T_vehicle_sensor)


def test_a_sensor_that_looks_to_the_left_sees_ahead_what_is_left_of_the_vehicle() -> None:
    left = Mounting(2.0, 1.0, 0.5, yaw_deg=90.0)
    np.testing.assert_allclose(left.T_vehicle_sensor @ [10.0, 0.0, 0.0, 1.0], [2.0, 11.0, 0.5, 1.0], atol=1e-12)
    down = Mounting(pitch_deg=90.0)  # the nose goes down
    np.testing.assert_allclose(down.T_vehicle_sensor @ [1.0, 0.0, 0.0, 1.0], [0.0, 0.0, -1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize(
    "value",
    ["", "1,2,3", "1,2,3,4,5,x", "nan,0,0,0,0,0", "0,0,101,0,0,0", "0,0,0,361,0,0", [1, 2], [1, 2, 3, 4, 5, "6"],
     {"x": 1}, {}, {"x_m": True}, {"yaw_deg": float("inf")}, {"x_m": 10**5000}, 5, None],
)  # fmt: skip
def test_what_is_no_mounting_is_refused(value: object) -> None:
    with pytest.raises(SettingsError, match="mounting"):
        Mounting.of_values(value)


def wrong(**cells: float) -> np.ndarray:
    T = np.eye(4)
    for name, value in cells.items():
        T[int(name[1]), int(name[2])] = value
    return T


@pytest.mark.parametrize(
    "T", [wrong(c03=101.0), wrong(c00=np.nan), wrong(c00=-1.0), wrong(c01=0.1), wrong(c00=1e300), wrong(c13=-np.inf)]
)
def test_a_section_that_is_no_mounting_is_damage(T: np.ndarray) -> None:
    with pytest.raises(SectionError, match="mounting"):
        encode_mount(T)
    with pytest.raises(SectionError, match="mounting"):
        decode_mount(T[:3].astype("<f8").tobytes())
    with pytest.raises(SectionError, match="bytes"):
        decode_mount(bytes(SECTION_BYTES - 8))


def coded(sent: list[Frame], **changes: object) -> list[Message]:
    encoder = StreamEncoder(StreamSettings(**changes), stream_id=7)
    messages = [unpack(pack(one)) for frame in sent for one in encoder.encode(frame)]
    return messages + [unpack(pack(one)) for one in encoder.flush()]


def mounted(count: int, *mounts: Mounting | None) -> list[Frame]:
    said = [mounts[min(at, len(mounts) - 1)] for at in range(count)]
    return [
        frames.scene(4, index=at).with_(mount=None if one is None else one.T_vehicle_sensor)
        for at, one in enumerate(said)
    ]


@pytest.mark.parametrize("codec", ["raw", "pcodec", "jpeg-layered", "riddle"])
def test_every_frame_comes_with_the_mounting_that_key_messages_say(codec: str) -> None:
    if codec == "jpeg-layered":
        pytest.importorskip("imagecodecs", reason="extra `images`")
    messages = coded(mounted(7, ROOF), codec=codec, key_interval=3)
    assert {one.key for one in messages} == {True, False} or codec == "jpeg-layered"
    assert [one.has(SectionType.MOUNT) for one in messages] == [one.key for one in messages]
    decoder = StreamDecoder()
    came = [frame for one in messages for frame in decoder.decode(one)]
    assert len(came) == 7
    for frame in came:
        np.testing.assert_array_equal(frame.mount, ROOF.T_vehicle_sensor)
        assert frame.mount is not None
        assert not frame.mount.flags.writeable


def test_frames_of_other_sensors_have_it_too() -> None:
    sensor, layout = next(one for one in made_layouts() if one[0].model == "vlp16")
    sent = made_frames(sensor, layout, 4, 1)[0].with_(mount=FRONT.T_vehicle_sensor)
    (message,) = coded([sent], codec="pcodec")
    (came,) = StreamDecoder().decode(message)
    np.testing.assert_array_equal(came.mount, FRONT.T_vehicle_sensor)


def test_another_mounting_and_another_stream_begin_with_a_key_message() -> None:
    messages = coded(mounted(4, None, None, ROOF, FRONT), key_interval=100)
    assert [one.key for one in messages] == [True, False, True, True]
    decoder = StreamDecoder()
    came = [decoder.decode(one)[0].mount for one in messages]
    assert came[:2] == [None, None]
    np.testing.assert_array_equal(came[2], ROOF.T_vehicle_sensor)
    np.testing.assert_array_equal(came[3], FRONT.T_vehicle_sensor)
    other = StreamEncoder(StreamSettings(), stream_id=8).encode(frames.scene(4))
    assert decoder.decode(other[0])[0].mount is None


def test_a_damaged_mounting_costs_its_message_and_no_other() -> None:
    first, second = coded(mounted(2, ROOF), key_interval=1)
    bad = tuple(Section(one.type, one.data[:-1], one.ordinal) if one.type == SectionType.MOUNT else one
                for one in first.sections)  # fmt: skip
    twice = (*first.sections, first.sections[-1])
    decoder = StreamDecoder()
    for sections in (bad, twice):
        with pytest.raises(SectionError):
            decoder.decode(Message(**(vars(first) | {"sections": sections})))
    assert decoder.decode(second)[0].mount is not None


def test_a_reader_skips_a_mounting_of_a_frame_that_is_not_there() -> None:
    """As one that does not know the section: it belongs to the message."""
    (message,) = coded(mounted(1, None))
    far = Section(SectionType.MOUNT, encode_mount(ROOF.T_vehicle_sensor), 5)
    again = unpack(pack(Message(**(vars(message) | {"sections": (*message.sections, far)}))))
    assert StreamDecoder().decode(again)[0].mount is None


def test_a_frame_keeps_it_in_a_pickle_and_refuses_another_shape() -> None:
    (frame,) = mounted(1, ROOF)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(frame)).mount, ROOF.T_vehicle_sensor)
    with pytest.raises(LidarCodecError, match="mount"):
        frame.with_(mount=np.eye(3))


def test_the_pose_of_the_vehicle_is_that_of_the_sensor_without_its_mounting() -> None:
    pose = Mounting(10, 20, 0, yaw_deg=30).T_vehicle_sensor
    T_world_sensor = pose @ ROOF.T_vehicle_sensor
    np.testing.assert_allclose(vehicle_pose(T_world_sensor, ROOF.T_vehicle_sensor), pose, atol=1e-12)
    assert vehicle_pose(pose, None) is pose
