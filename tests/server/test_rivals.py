"""Two servers, or a server and another program, set one vehicle: it is said, and they do not go on for ever."""

from __future__ import annotations

import asyncio
import json
import shutil
import time

import pytest

from lidarcodec.apps.publisher.desk import CHANGES_AT_ONCE
from lidarcodec.settings import StreamSettings
from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.fleet import fleet
from lidarcodec_server.fleet.rivals import TELL_S, TIMES, WITHIN_S, Rivals
from tests.command_line import start
from tests.server.conftest import STREAM, until
from tests.server.test_processes import CAR, Server
from tests.server.test_processes import until as until_now
from tests.server.test_settings import applied, audit, there
from tests.transport.conftest import free_port

KEYS = StreamKeys("car-7", "roof")
OURS, THEIRS = {"key_interval": 5}, StreamSettings(key_interval=9)


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_what_was_sent_and_is_told_is_no_rival():
    rivals = Rivals()
    rivals.sent(KEYS, OURS)
    assert not rivals.told(KEYS, StreamSettings(key_interval=5, max_error_m=0.1))
    rivals.returned(KEYS)
    assert not rivals.told(KEYS, THEIRS), "it came back with the settings of its command line"
    assert rivals.to_tell(KEYS) is None


def test_a_server_that_is_overridden_again_and_again_leaves_the_vehicle_until_an_operator_asks():
    clock = Clock()
    rivals = Rivals(clock)
    for number in range(TIMES):
        assert not rivals.leave_it(KEYS)
        rivals.sent(KEYS, OURS)
        assert rivals.told(KEYS, THEIRS)
        assert rivals.to_tell(KEYS) == ("key_interval is 9, not 5", True), number
        clock.now += TELL_S
    assert rivals.leave_it(KEYS)
    clock.now += WITHIN_S
    assert not rivals.leave_it(KEYS)
    rivals.sent(KEYS, OURS)
    rivals.told(KEYS, THEIRS)
    rivals.forget(KEYS)
    assert not rivals.leave_it(KEYS)


def test_a_vehicle_whose_settings_change_all_the_time_does_not_fill_the_audit_log():
    clock = Clock()
    rivals = Rivals(clock)
    told = 0
    for _ in range(1000):
        rivals.sent(KEYS, OURS)
        assert rivals.told(KEYS, THEIRS)
        told += rivals.to_tell(KEYS).new
        clock.now += 0.1
    assert told <= 2 + 100 / TELL_S


async def overridden(client):
    async def is_it():
        refused = (await client.get(f"{STREAM}/settings")).json()["refused"]
        return refused if refused and "another server" in refused else None

    return await until(is_it)


async def test_an_operator_sees_that_somebody_else_set_the_vehicle(serving, vehicle, network, monkeypatch):
    monkeypatch.setattr(fleet, "ANSWER_HOLDS_S", 0.2)
    car = vehicle()
    async with serving() as client:
        await there(client)
        assert (await client.patch(f"{STREAM}/settings", json=OURS)).status_code == 200
        with network.transport() as other:
            other.ask(KEYS.control_set, b'{"key_interval": 9}')
        assert "key_interval is 9, not 5" in await overridden(client)
        assert car.settings.key_interval == 9, "the server does not fight"
        assert [(one["who"], one["result"]) for one in await audit(client)] == [
            ("somebody else", "overridden"),
            ("127.0.0.1", "applied"),
        ]
        assert (await client.patch(f"{STREAM}/settings", json={"key_interval": 6})).status_code == 200
        assert (await client.get(f"{STREAM}/settings")).json()["refused"] is None


@pytest.mark.sweep
async def test_after_several_rounds_a_server_sends_no_more_to_a_vehicle_that_comes_back(
    serving, vehicle, network, monkeypatch
):
    monkeypatch.setattr(fleet, "ANSWER_HOLDS_S", 0.2)
    async with serving() as client:
        with network.transport() as other:
            car = vehicle()
            await there(client)
            await client.patch(f"{STREAM}/settings", json=OURS)
            for _ in range(TIMES):
                await applied(client, **OURS)
                await asyncio.sleep(1.5)  # its first status has it looked at once more
                other.ask(KEYS.control_set, b'{"key_interval": 9}')
                refused = await overridden(client)
                await asyncio.to_thread(car.stop)
                car = vehicle()
            assert "nothing more is sent to it" in refused
            await there(client)
            await asyncio.sleep(1.0)
            assert car.settings.key_interval == 50, "that of its command line"
            assert (await client.patch(f"{STREAM}/settings", json=OURS)).status_code == 200


async def test_a_change_that_comes_too_soon_is_sent_again(serving, vehicle, network):
    """Others may use up all changes that a vehicle takes; what an operator wants waits, and is not refused."""
    car = vehicle()
    async with serving() as client:
        await there(client)
        with network.transport() as other:
            answers = [json.loads(other.ask(KEYS.control_set, b'{"key_interval": 9}')) for _ in range(200)]
        assert any("retry_s" in answer for answer in answers)
        answer = await client.patch(f"{STREAM}/settings", json=OURS)
        assert answer.status_code in (200, 202), answer.text
        await applied(client, **OURS)
        assert car.settings.key_interval == 5
        assert sum("applied" in answer for answer in answers) <= 2 * CHANGES_AT_ONCE
        assert car.status()["errors"]["changes refused"] > 0


@pytest.mark.timeout(180)
def test_two_servers_with_settings_for_one_vehicle_say_so_and_come_to_rest(tmp_path, empty_database):
    where = {"LIDARCODEC_LOOPBACK_PORT": str(free_port())}
    for name in ("a.db", "b.db"):
        shutil.copy(empty_database, tmp_path / name)
    servers = [Server(None, f"sqlite:///{tmp_path / name}", **where) for name in ("a.db", "b.db")]
    publish = ("publish", "sim:road?sensor=vlp16&frames=100000", *CAR, "--codec", "zstd", "--rate", "3")
    car = start(*publish, variables=where)
    try:
        for server, interval in zip(servers, (5, 9), strict=True):
            until_now(server.alive)
            server.patched(key_interval=interval)
        first, second = servers
        assert "key_interval is 9, not 5" in until_now(lambda: first.get(f"{STREAM}/settings")["refused"])
        assert second.get(f"{STREAM}/settings")["refused"] is None
        entries = first.get(f"{STREAM}/audit")
        assert entries[0]["result"] == "overridden"
        assert len(entries) == 2
        assert second.get(f"{STREAM}/settings")["applied"]["key_interval"] == 9
        car.terminate()
        car.wait(60)
        car = start(*publish, variables=where)
        until_now(lambda: {server.get(STREAM)["settings"]["key_interval"] for server in servers} in ({5}, {9}))

        def at_rest() -> bool:
            before = [len(server.get(f"{STREAM}/audit")) for server in servers]
            time.sleep(3.0)
            return [len(server.get(f"{STREAM}/audit")) for server in servers] == before

        until_now(at_rest)  # they do not go on for ever
    finally:
        for process in (car, *(server.process for server in servers)):
            process.terminate()
        for process in (car, *(server.process for server in servers)):
            process.wait(60)
