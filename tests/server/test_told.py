"""What a vehicle tells goes to every browser that looks: nothing passes but known fields of their type and size."""

from __future__ import annotations

import json
from itertools import cycle
from pathlib import Path

import pytest

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.apps.timings import BOUNDS_MS
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.base import Priority
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError
from lidarcodec_server import told
from lidarcodec_server.told import known_settings, read_answer, read_status
from tests.apps.streams import Loop
from tests.server.conftest import STREAM, until
from tests.sweeps import combined

KEYS = StreamKeys("car-7", "roof")
OTHER = [
    None,
    True,
    -1,
    1e300,
    10**19,
    "x" * 20_000,
    "<img src=x onerror=alert(1)>",
    [],
    [1] * 5000,
    ["x" * 9000],
    {},
    {"a" * 600: 1},
    {f"n{i}": i for i in range(3000)},
    {"x": {"x": {"x": {"x": "y" * 9000}}}},
]
SETTINGS = [
    None,
    StreamSettings(codec="jpeg", target_kbps="auto"),
    StreamSettings(codec="pcodec", target_kbps=4000),
    StreamSettings(codec="zstd", reduction="voxel", keep_points=20_000),
    StreamSettings(codec="raw", reduction="columns:4"),
]


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
async def test_nothing_of_what_our_own_vehicles_tell_is_dropped(network, settings, tmp_path):
    """Else a field that is added to the status never reaches anybody who looks."""
    transport = network.transport()
    with Publisher(Loop(), settings, vehicle="car-7", sensor="roof", transport=transport, record=tmp_path) as car:

        async def sends():
            return car.status()["frames"] > 2

        with network.transport() as other:
            inbox = other.inbox(KEYS.frame)
            await until(sends)
            inbox.close()
        status = car.status()
    found = read_status(json.dumps(status).encode())
    assert found.dropped == 0
    assert found.status == status


def test_every_field_that_the_document_lists_is_known_and_no_other():
    page = (Path(__file__).parents[2] / "docs" / "live.md").read_text(encoding="utf-8")
    table = page.partition("## Status\n")[2].partition("\n\nFrames sent")[0]
    first_cells = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    assert {name for cell in first_cells for name in cell.replace("`", " ").split()} == set(told._FIELDS)


@pytest.mark.parametrize("field", sorted(told._FIELDS))
def test_no_field_takes_a_value_of_another_type_or_size(field):
    for value in OTHER:
        found = read_status(json.dumps({field: value, "fps": 7.5}).encode())
        assert len(json.dumps(found.status)) < 8192, (field, str(value)[:40])
        assert found.status["fps"] == (7.5 if field != "fps" else found.status.get("fps", 7.5))


@pytest.mark.timeout(300)
async def test_whatever_vehicles_tell_every_page_of_the_server_answers(serving, network):
    """A status that was deep enough once made the list of streams fail for everybody, for good."""
    deep = '{"stream_id": "aa", "x": ' + "[" * 300 + "]" * 300 + "}"
    nan = '{"stream_id": "aa", "settings": {"x": NaN}}'
    settings = json.dumps({"settings": {"codec_settings": {"x": "A" * 50_000}}})
    whole = [text for text in (deep, nan, settings) for _ in range(3)]  # for each of the three pages
    texts = [*whole, *(json.dumps({name: value}) for name, value in combined(told._FIELDS, OTHER))]
    with network.transport() as bad:
        sender, token = bad.sender(KEYS.status, Priority.STATUS), bad.token(KEYS.alive)
        async with serving() as client:

            async def seen():
                return (await client.get(STREAM)).status_code == 200

            await until(seen)
            for text, path in zip(texts, cycle(("/api/v1/streams", "/api/v1/fleet", "/metrics")), strict=False):
                sender.put(text.encode())
                answer = await client.get(path)
                assert answer.status_code == 200, (path, text[:60])
                assert len(answer.content) < 50_000, (path, text[:60])
                assert b"NaN" not in answer.content
            counted = (await client.get("/metrics")).text
        token.close()
    assert "lidarcodec_statuses_refused_total 6.0" in counted
    assert "lidarcodec_status_fields_dropped_total 0.0" not in counted


def test_settings_are_small_and_plain():
    for value in ("A" * 9000, [[[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]], {"x": float("nan")}, "\ud800"):
        assert known_settings({"codec": "pcodec", "codec_settings": {"x": value}}) is None
    assert known_settings({"codec": "pcodec", "codec_settings": {"level": 3}}) is not None


@pytest.mark.parametrize("values", [{"x": "y" * 9000}, {"codec_settings": {"x": ["y" * 400] * 25}}])
async def test_large_settings_are_refused_before_a_vehicle_is_asked(serving, values):
    async with serving() as client:
        answer = await client.patch(f"{STREAM}/settings?prepare=true", json=values)
        assert answer.status_code == 422
        assert "8,192 are allowed" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b'{"max_seconds": NaN}', "NaN is not JSON"),
        (b'{"max_seconds": 1e999}', "out of range"),
        (b'{"x": ' + b"[" * 300 + b"]" * 300 + b"}", "nested more than 16 deep"),
        (b'{"max_bytes": ' + b"9" * 400 + b"}", "400 digits"),
        (b"{", "malformed JSON"),
        (b'{"x": "\\ud800"}', "surrogate"),
    ],
    ids=lambda value: str(value)[:20],
)
async def test_bodies_are_checked_before_any_route_reads_them(serving, body, reason):
    paths = [("PATCH", f"{STREAM}/settings"), ("POST", f"{STREAM}/recording"), ("PATCH", "/api/v1/recordings/x/play")]
    async with serving(changes_per_second=1000.0, burst=1000) as client:
        for method, path in paths:
            for headers in ({"Content-Type": "application/json"}, {"Content-Type": "text/x+json"}):
                answer = await client.request(method, path, content=body, headers=headers)
                assert answer.status_code == 422, (path, answer.text)
                assert reason in answer.json()["detail"], (path, answer.text)


async def test_a_body_that_is_too_long_is_said_to_be_so_by_every_route(serving):
    async def body():
        for _ in range(100):
            yield b" " * 1000

    async with serving(max_body_bytes=2000) as client:
        for method, path in (("PATCH", "settings"), ("POST", "recording")):
            headers = {"Content-Type": "application/json"}
            answer = await client.request(method, f"{STREAM}/{path}", content=body(), headers=headers)
            assert answer.status_code == 413, path


def test_answers_are_read_within_the_same_limits():
    for data in (b"[]", b"[" * 40 + b"]" * 40, b'{"first_frame": NaN}', b"x"):
        with pytest.raises(JsonRefusedError):
            read_answer(data)
    assert told.first_frame({"first_frame": True}) is None
    assert told.first_frame({"first_frame": 7}) == 7
    assert len(BOUNDS_MS) + 1 == told.BUCKETS
