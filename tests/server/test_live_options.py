"""What a viewer may ask for: anything else is refused by the name of the option, before a socket is opened."""

import pytest

from lidarcodec.errors import SettingsError
from lidarcodec.transport import Endpoints
from lidarcodec_server.live.options import CloudOptions, FramesOptions
from lidarcodec_server.live.part import beside


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ({"form": "mesh"}, "form"),
        ({"attributes": "colour"}, "attributes"),
        ({"form": "range", "attributes": "ring"}, "attributes"),
        ({"form": "range", "max_points": "5"}, "max_points"),
        ({"max_points": "0"}, "max_points"),
        ({"max_points": "9" * 5000}, "max_points"),
        ({"max_points": "\u0663"}, "max_points"),
        ({"rate": "nan"}, "rate"),
        ({"rate": "-1"}, "rate"),
        ({"rate": "inf"}, "rate"),
        ({"window": "100"}, "window"),
        ({"fill": "2"}, "fill"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_what_cannot_be_is_refused_by_name(query, field):
    with pytest.raises(SettingsError) as caught:
        CloudOptions.of(query)
    assert caught.value.field == field


def test_nothing_is_made_up_for_a_viewer_that_could_not_tell_it_from_what_was_measured():
    assert CloudOptions.of({}).encoding.fill
    assert CloudOptions.of({"form": "range"}).encoding.fill
    assert not CloudOptions.of({"attributes": "ring"}).encoding.fill
    assert not CloudOptions.of({"form": "range", "attributes": "intensity,original"}).encoding.fill
    assert CloudOptions.of({"attributes": "ring", "fill": "1"}).encoding.fill
    assert not CloudOptions.of({}, fill=False).encoding.fill
    assert CloudOptions.of({"fill": "1"}, fill=False).encoding.fill


def test_the_frames_socket_has_a_window_and_nothing_else():
    assert FramesOptions.of({"window": "3"}).window == 3
    with pytest.raises(SettingsError):
        FramesOptions.of({"rate": "5"})


@pytest.mark.parametrize(
    ("given", "listen", "connect"),
    [
        (Endpoints(listen=("tcp/0.0.0.0:7447",)), (), ("tcp/127.0.0.1:7447",)),
        (Endpoints(listen=("tcp/[::]:7447",), connect=("tcp/a:1",), mode="router"), (), ("tcp/a:1", "tcp/[::1]:7447")),
        (Endpoints(connect=("tcp/a:1",)), (), ("tcp/a:1",)),
        (Endpoints(), (), ()),
    ],
)
def test_a_playback_s_session_finds_that_of_the_server(given, listen, connect):
    session = beside(given)
    assert (session.listen, session.connect) == (listen, connect)
