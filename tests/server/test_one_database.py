"""Two servers with one database: each has operators, and neither takes back what those of the other one did."""

from __future__ import annotations

import asyncio

import pytest

from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.fleet import fleet
from lidarcodec_server.store.store import Store
from lidarcodec_server.store.wanted import ChangedError
from tests.server.conftest import STREAM, until
from tests.server.test_settings import audit, there
from tests.server.test_store import postgres, url

__all__ = ["postgres", "url"]

CAR = StreamKeys("car-7", "roof")
SETTINGS = f"{STREAM}/settings"


async def test_two_changes_at_once_on_two_servers_are_both_kept(serving, vehicle, tmp_path):
    """Both were answered with 200, and one of them was gone: at the vehicle, or in the database."""
    car = vehicle()
    shared = {"database_url": f"sqlite:///{tmp_path / 'one.db'}"}
    async with serving(**shared) as one, serving(**shared) as other:
        await there(one)
        await there(other)
        for number in range(10):
            pair = {"key_interval": 20 + number}, {"max_error_m": 0.002 * (number + 1)}
            answers = await asyncio.gather(
                *(client.patch(SETTINGS, json=asked) for client, asked in zip((one, other), pair, strict=True))
            )
            assert [answer.status_code for answer in answers] == [200, 200], [answer.text for answer in answers]
            wanted = pair[0] | pair[1]
            told = (await other.get(SETTINGS)).json()
            assert {name: told["desired"][name] for name in wanted} == wanted
            assert {name: told["applied"][name] for name in wanted} == wanted
            assert {name: getattr(car.settings, name) for name in wanted} == wanted


async def test_what_the_other_server_sent_is_no_override(serving, vehicle, tmp_path, monkeypatch):
    """The log said that somebody else had changed settings, and after three times that nothing more is sent."""
    monkeypatch.setattr(fleet, "ANSWER_HOLDS_S", 0.2)
    vehicle()
    shared = {"database_url": f"sqlite:///{tmp_path / 'one.db'}"}
    async with serving(**shared) as one, serving(**shared) as other:
        await there(one)
        await there(other)
        for number in range(4):
            for client in (one, other):
                asked = {"key_interval": 20 + number + 10 * (client is one)}
                assert (await client.patch(SETTINGS, json=asked)).status_code == 200
                await asyncio.sleep(1.2)  # a status of the vehicle comes to both

        async def refused(client):
            return (await client.get(SETTINGS)).json()["refused"]

        assert [await refused(one), await refused(other)] == [None, None]
        assert {(entry["who"], entry["result"]) for entry in await audit(one)} == {("127.0.0.1", "applied")}


def test_a_change_to_what_another_server_has_changed_since_is_not_stored(url):
    """Of each kind of database; the first change of a stream, too."""
    one, other = Store(url), Store(url)
    for store in (one, other):
        store.open()
    one.begin(CAR, "ada", "settings", {}, None, {"codec": "raw"}, {})
    with pytest.raises(ChangedError):
        other.begin(CAR, "otto", "settings", {}, None, {"key_interval": 9}, {})
    both = {"codec": "raw", "key_interval": 9}
    entry = other.begin(CAR, "otto", "settings", {}, None, both, {"codec": "raw"})
    assert one.desired(CAR) == both
    one.begin(CAR, "ada", "settings", {}, None, both | {"codec": "zstd"}, both)
    other.finish(entry, "refused", restore=(CAR, {"codec": "raw"}, both))
    assert one.desired(CAR) == {"codec": "zstd"}, "what was not refused stays"
    assert len(one.audit(CAR)) == 3
    for store in (one, other):
        store.close()


@pytest.mark.parametrize("away", [False, True])
async def test_a_vehicle_that_comes_back_has_what_operators_of_both_servers_set(serving, vehicle, tmp_path, away):
    shared = {"database_url": f"sqlite:///{tmp_path / 'one.db'}"}
    car = vehicle()
    async with serving(**shared) as one, serving(**shared) as other:
        await there(one)
        await there(other)
        if away:
            await asyncio.to_thread(car.stop)
        await asyncio.gather(
            one.patch(SETTINGS, json={"key_interval": 7}), other.patch(SETTINGS, json={"max_error_m": 0.01})
        )
        if not away:
            await asyncio.to_thread(car.stop)
        again = vehicle()

        async def both():
            return (again.settings.key_interval, again.settings.max_error_m) == (7, 0.01)

        await until(both)
