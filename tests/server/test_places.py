"""Room in a fleet: no vehicle, whatever it declares, hides another one."""

from __future__ import annotations

import logging
import re

import pytest

from lidarcodec.transport.keys import StreamKeys
from lidarcodec_server.fleet import places
from lidarcodec_server.fleet.fleet import Fleet
from tests.server.conftest import until


def of(vehicle: str, count: int) -> list[StreamKeys]:
    return [StreamKeys(vehicle, f"s{number}") for number in range(count)]


def names(fleet: Fleet) -> list[str]:
    return [f"{one.keys.vehicle}/{one.keys.sensor}" for one in fleet.streams() if one.alive]


def tell(fleet: Fleet, keys: StreamKeys) -> bool:
    return fleet.told(keys, b'{"stream_id": "1"}')


def test_a_vehicle_of_300_sensors_takes_its_own_places_only(caplog):
    fleet = Fleet()
    with caplog.at_level(logging.WARNING):
        taken = [fleet.changed(keys, alive=True) for keys in of("big", 300)]
    assert taken.count(True) == 16
    assert fleet.left_out() == (284, {"big": 284})
    assert "big/s16 is not shown: its vehicle already has 16 sensors, which is the limit (--max-sensors)" in caplog.text
    assert all(fleet.changed(keys, alive=True) for keys in of("car-7", 3))


def test_a_sensor_that_was_left_out_comes_in_when_another_one_of_its_vehicle_went():
    fleet = Fleet(max_sensors=2)
    first, second, third = of("car", 3)
    assert [fleet.changed(keys, alive=True) for keys in (first, second, third)] == [True, True, False]
    assert not tell(fleet, third)
    fleet.changed(first, alive=False)
    assert tell(fleet, third)
    assert names(fleet) == ["car/s1", "car/s2"]


def test_where_all_places_are_taken_the_vehicle_with_the_most_gives_way():
    fleet = Fleet(max_streams=20)
    for keys in (*of("big", 16), *of("small", 2), *of("other", 2)):
        assert fleet.changed(keys, alive=True)
        tell(fleet, keys)
    late = StreamKeys("late", "roof")
    assert fleet.changed(late, alive=True)
    assert sum(name.startswith("big/") for name in names(fleet)) == 15
    assert {"small/s0", "small/s1", "other/s0", "other/s1", "late/roof"} <= set(names(fleet))
    for _ in range(3):
        for keys in of("big", 16):
            tell(fleet, keys)
    assert "late/roof" in names(fleet), "who gave way does not push others out"


def test_among_equals_who_is_there_stays():
    fleet = Fleet(max_streams=4)
    for number in range(4):
        fleet.changed(StreamKeys(f"car-{number}", "roof"), alive=True)
    assert not fleet.changed(StreamKeys("car-4", "roof"), alive=True)
    assert len(names(fleet)) == 4


def test_tokens_without_a_stream_behind_them_give_way_to_those_that_tell(monkeypatch):
    monkeypatch.setattr(places, "MUTE_S", -1.0)
    fleet = Fleet(max_streams=8)
    for number in range(100):
        fleet.changed(StreamKeys(f"ghost-{number}", "x"), alive=True)
    late = StreamKeys("car-7", "roof")
    assert not fleet.changed(late, alive=True)
    assert tell(fleet, late)
    assert "car-7/roof" in names(fleet)


def test_those_that_wait_are_bounded_by_vehicle_and_together():
    fleet = Fleet(max_streams=1)
    for keys in (*of("big", 500), *(StreamKeys(f"car-{number}", "roof") for number in range(3000))):
        fleet.changed(keys, alive=True)
    waiting = fleet._places.waiting
    assert len(waiting) <= places.MAX_WAITING
    assert sum(keys.vehicle == "big" for keys in waiting) <= 16
    assert len(fleet.left_out()[1]) <= places.MAX_COUNTED


@pytest.mark.timeout(60)
async def test_operators_see_every_vehicle_beside_one_of_300_sensors_and_which_was_left_out(serving, vehicle, network):
    with network.transport() as bad:
        tokens = [bad.token(keys.alive) for keys in of("big", 300)]
        async with serving() as client:

            async def full():
                seen = [one["vehicle"] for one in (await client.get("/api/v1/streams")).json()]
                return seen.count("big") == 16

            await until(full)
            vehicle(name="car-8")

            async def seen():
                return "car-8" in [one["vehicle"] for one in (await client.get("/api/v1/fleet")).json()]

            await until(seen)
            rows = {one["vehicle"]: one["left_out"] for one in (await client.get("/api/v1/fleet")).json()}
            assert rows == {"big": 16, "car-8": 0}, "as many as are remembered of it"
            text = (await client.get("/metrics")).text
            assert re.search(r'lidarcodec_vehicle_streams_left_out_total{vehicle="big"} 2\d\d\.0', text)
        for token in tokens:
            token.close()


async def test_a_vehicle_of_which_no_stream_has_room_is_in_the_list_of_the_fleet(serving, network):
    """Only the log and the metrics said that it was there."""
    with network.transport() as cars:
        tokens = [cars.token(keys.alive) for keys in of("first", 1) + of("second", 1)]
        async with serving(max_streams=2) as client:

            async def full():
                return len((await client.get("/api/v1/fleet")).json()) == 2

            await until(full)
            tokens += [cars.token(keys.alive) for keys in of("late", 3)]

            async def told():
                return [row for row in (await client.get("/api/v1/fleet")).json() if row["vehicle"] == "late"]

            (row,) = await until(told)
            assert (row["room"], row["alive"], row["codec"], row["silent_s"]) == (False, True, None, None)
            rows = (await client.get("/api/v1/fleet")).json()
            assert {one["vehicle"]: (one["room"], one["left_out"]) for one in rows} == {
                "first": (True, 0),
                "late": (False, row["left_out"]),
                "second": (True, 0),
            }
            assert 1 <= row["left_out"] <= 3
        for token in tokens:
            token.close()
