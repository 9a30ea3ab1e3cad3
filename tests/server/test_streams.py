"""Which streams there are: a fleet that a server does not see is a fleet that nobody looks after."""

from __future__ import annotations

import pytest

from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.fleet.fleet import Stream
from lidarcodec_server.schemas import StreamAnswer
from tests.server.conftest import STREAM, until


async def test_a_vehicle_is_seen_with_its_settings_and_seen_to_go(serving, vehicle):
    async with serving() as client:
        assert (await client.get("/api/v1/streams")).json() == []
        car = vehicle()

        async def told():
            found = (await client.get("/api/v1/streams")).json()
            return found and found[0]["status"] and found

        (found,) = await until(told)
        assert (found["vehicle"], found["sensor"], found["alive"]) == ("car-7", "roof", True)
        assert found["settings"] == car.settings.model_dump()
        car.stop()

        async def gone():
            return not (await client.get(STREAM)).json()["alive"]

        assert await until(gone)


async def test_a_vehicle_that_was_there_before_the_server_is_seen(serving, vehicle):
    vehicle()
    async with serving() as client:

        async def there():
            return (await client.get(STREAM)).status_code == 200

        assert await until(there)


@pytest.mark.parametrize(
    ("method", "path", "status", "says"),
    [
        ("GET", "/api/v1/streams/nobody/roof", 404, "was never seen"),
        ("GET", "/api/v1/streams/a%20b/roof", 422, "vehicle"),
        ("GET", "/nothing", 404, "GET /nothing: there is no such address"),
        ("DELETE", "/healthz", 405, "this address takes GET"),
    ],
)
async def test_every_refusal_is_a_problem_that_says_what_is_wrong(serving, method, path, status, says):
    async with serving() as client:
        answer = await client.request(method, path)
    assert answer.status_code == answer.json()["status"] == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert {"type", "title", "detail"} <= set(answer.json())
    assert says in answer.json()["detail"]


async def test_more_streams_than_allowed_are_left_out_and_those_gone_make_room(serving, vehicle):
    async with serving(max_streams=2) as client:
        first = vehicle(name="a")
        vehicle(name="b")

        async def names():
            return [one["vehicle"] for one in (await client.get("/api/v1/streams")).json()]

        async def both():
            return await names() == ["a", "b"]

        assert await until(both)
        first.stop()

        async def gone():
            return not (await client.get("/api/v1/streams/a/roof")).json()["alive"]

        await until(gone)
        vehicle(name="c")

        async def replaced():
            return await names() == ["b", "c"]

        assert await until(replaced)


def told(settings: StreamSettings, rate: dict, *, of: StreamSettings | None = None) -> list[str]:
    """Codes of the warnings of a stream that tells this."""
    status = {"settings": (of or settings).model_dump(), "rate": rate}
    answer = StreamAnswer.of(Stream(StreamKeys("car-7", "roof"), alive=True, settings=settings, status=status))
    return [warning.code for warning in answer.warnings]


def test_everybody_who_looks_is_told_of_a_target_that_is_missed():
    settings = StreamSettings(codec="riddle", target_kbps=1000, max_error_m=0, intensity="lossless", reduction="all")
    ends = [4500.0, 4600.0]
    missed = {"target_kbps": 1000.0, "kbps_5s": 4575.0, "limited_by": "floor", "reachable_kbps": ends}
    assert told(settings, missed) == ["target_missed"]
    assert told(settings, missed | {"kbps_5s": 900.0}) == ["frames_left_out"]
    kept = {"target_kbps": 1000.0, "kbps_5s": 900.0, "limited_by": "target", "reachable_kbps": [300.0, 9000.0]}
    assert told(settings, kept) == []
    before = settings.changed(target_kbps=None)
    assert told(settings, kept, of=before) == ["target_out_of_reach"], "that status is older than these settings"


@pytest.mark.parametrize(
    "settings",
    [
        StreamSettings(codec="of a newer version", target_kbps=10),
        StreamSettings(codec="jpeg", codec_settings={"quality": "best"}, target_kbps=10),
        StreamSettings(codec="riddle", reduction="lattice:all", target_kbps=10),
    ],
)
def test_settings_that_cannot_be_followed_here_are_shown_without_a_word(settings):
    assert told(settings, {"target_kbps": 10.0, "reachable_kbps": [500.0, 600.0], "limited_by": "floor"}) == []
