"""Keys and endpoints as people write them: a typing error is named, not sent somewhere else."""

from __future__ import annotations

import pytest

from lidarcodec.errors import SettingsError, TransportError
from lidarcodec.settings import is_name, settings_from
from lidarcodec.transport.endpoints import Endpoints
from lidarcodec.transport.keys import StreamKeys, matches


@pytest.mark.parametrize(
    ("expression", "key", "covered"),
    [
        ("a/b", "a/b", True),
        ("a/b", "a/b/c", False),
        ("a/*", "a/b", True),
        ("a/*", "a", False),
        ("a/*", "a/b/c", False),
        ("a/**", "a", True),
        ("a/**", "a/b/c", True),
        ("**/alive", "a/b/alive", True),
        ("a/**/c", "a/c", True),
        ("a/**/c", "a/b/b/d", False),
    ],
)
def test_an_expression_covers_what_zenoh_says_it_covers(expression, key, covered):
    zenoh = pytest.importorskip("zenoh")
    assert matches(expression, key) is covered
    assert zenoh.KeyExpr(expression).includes(key) is covered


@pytest.mark.parametrize("text", ["vehicle/lidar", "lidarcodec/v1/vehicle/lidar"])
def test_a_stream_is_named_with_or_without_the_prefix(text):
    assert StreamKeys.parse(text) == StreamKeys("vehicle", "lidar")


@pytest.mark.parametrize("text", ["", "lidar", "a/b/c", "lidarcodec/v2/a/b", "a/*", "a/b c"])
def test_a_key_that_names_no_stream_is_refused(text):
    with pytest.raises(SettingsError):
        StreamKeys.parse(text)


def test_by_default_nothing_leaves_the_machine():
    options = Endpoints().options() | Endpoints().rendezvous_options()
    assert options["scouting/multicast/enabled"] is False
    for one in (Endpoints().options(), Endpoints().rendezvous_options()):
        for endpoint in one["listen/endpoints"] + one["connect/endpoints"]:
            assert endpoint.startswith("tcp/127.0.0.1:")


def test_behind_a_router_the_session_is_a_client_and_a_listener_is_a_peer():
    assert Endpoints.of(connect="tcp/router:7447").effective_mode == "client"
    assert Endpoints.of(connect="tcp/a:1", listen="tcp/0.0.0.0:1").effective_mode == "peer"
    assert Endpoints.of(connect="tcp/a:1", mode="peer").effective_mode == "peer"


def test_the_meeting_point_can_be_moved_by_an_environment_variable(monkeypatch):
    assert Endpoints().rendezvous == "tcp/127.0.0.1:7447"
    monkeypatch.setenv("LIDARCODEC_LOOPBACK_PORT", "17447")
    assert Endpoints().rendezvous == Endpoints.of().rendezvous == "tcp/127.0.0.1:17447"
    assert Endpoints.of(loopback_port=5).loopback_port == 5
    for wrong in ("none", "0", "65536", "\u00b2"):
        monkeypatch.setenv("LIDARCODEC_LOOPBACK_PORT", wrong)
        with pytest.raises(TransportError):
            Endpoints()


@pytest.mark.parametrize(
    "options",
    [
        {"connect": "192.168.1.5:7447"},
        {"listen": "http/0.0.0.0:7447"},
        {"connect": "tcp/192.168.1.5"},
        {"connect": "tcp/192.168.1.5:"},
        {"connect": "tcp/192.168.1.5:70000"},
        {"connect": "tcp/192.168.1.5:\u0663"},
        {"connect": "tcp/:::"},
        {"connect": "tcp/fe80::1:7447"},
        {"connect": "tcp/a:1#bad=1"},
        {"listen": "tcp/a:1#so_sndbuf=many"},
        {"connect": "tcp/a:1#so_sndbuf=65536;iface="},
        {"listen": "tcp/0.0.0.0:7447", "mode": "client"},
        {"mode": "client"},
        {"mode": "leaf", "connect": "tcp/a:1"},
        {"config": "/nowhere/zenoh.json5"},
        {"loopback_port": 0},
    ],
)
def test_endpoints_that_cannot_work_are_refused_with_a_reason(options):
    with pytest.raises(TransportError):
        Endpoints.of(**options)


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/192.168.1.5:7447",
        "tls/office.example:7447",
        "udp/[fe80::1%eth0]:7447",
        "quic/a:1#so_sndbuf=65536;so_rcvbuf=65536",
        "tcp/0.0.0.0:0",
        "tcp/a:1?prio=1-7",
        "tcp/a:1#iface=wwan0;so_sndbuf=65536",
        "unixsock-stream//run/lidar.sock",
    ],
)
def test_endpoints_as_zenoh_knows_them_are_taken(endpoint):
    assert Endpoints.of(connect=endpoint).connect == (endpoint,)


@pytest.mark.parametrize("name", [".", "..", "...", "." * 64, "", "a" * 65, "a/b", "a\n", "\u00e4"])
def test_a_name_that_is_a_path_or_too_long_is_refused_everywhere(name):
    """Names become parts of keys, and of paths of recordings."""
    assert not is_name(name)
    for make in (lambda: StreamKeys(name, "roof"), lambda: StreamKeys("car", name)):
        with pytest.raises(SettingsError):
            make()
    with pytest.raises(SettingsError):
        StreamKeys().arrived(name)
    with pytest.raises(SettingsError):
        settings_from({"follow": name})


@pytest.mark.parametrize("name", ["a", ".a", "..a", "a..", "-", "_", "." * 63 + "a", "a" * 64, "car-7.v2"])
def test_names_with_dots_and_something_else_are_names(name):
    assert StreamKeys.parse(f"{name}/{name}") == StreamKeys(name, name)
