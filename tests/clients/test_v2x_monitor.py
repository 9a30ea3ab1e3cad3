"""What a user would lose: the warning that something stands in the way, or his trust when it comes for nothing."""

from __future__ import annotations

import importlib.util
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.packet import Packet
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.sources.base import PacketSource
from lidarcodec.transport import Endpoints, open_transport
from tests.command_line import environment
from tests.sweeps import marked
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

MONITOR = Path(__file__).resolve().parents[2] / "clients" / "python" / "v2x_monitor"
LIMIT_S = 180.0
TENTH = 100_000_000


def module(name: str):
    """A file of the monitor."""
    spec = importlib.util.spec_from_file_location(f"v2x_{name}", MONITOR / f"{name}.py")
    found = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = found  # dataclasses look their module up
    spec.loader.exec_module(found)
    return found


zones = module("zones")
RULES = zones.Rules(stand=10, clear=5)
SQUARE = [[0.0, 0.0], [10.0, 0.0], [10.0, 6.0], [0.0, 6.0]]


def road(box: tuple[float, float] | None = None, slope: float = 0.0, seed: int = 1) -> np.ndarray:
    """Points of a road, with a car-sized box on it, whose ground shadow is empty."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform((-6.0, -6.0), (16.0, 12.0), (14000, 2))
    points = np.column_stack([ground, ground[:, 0] * slope + rng.normal(0.0, 0.02, len(ground))])
    if box is None:
        return points
    low, high = np.array(box), np.array([box[0] + 4.0, box[1] + 1.8])
    under = np.all((points[:, :2] > low) & (points[:, :2] < high), axis=1)
    body = rng.uniform((*low, 0.1), (*high, 1.5), (600, 3))
    body[:, 2] += body[:, 0] * slope
    return np.concatenate([points[~under], body])


def events(steps: list[np.ndarray], vehicles: tuple[str, ...] = ("a",), rules=RULES) -> list:
    zone = zones.Zone("z", SQUARE, rules)
    found = []
    for number, points in enumerate(steps):
        for vehicle in vehicles:
            event = zone.see(points, 10**18 + number * TENTH, vehicle)
            found += [(number, event)] if event else []
    return found


@pytest.mark.parametrize("slope", [0.0, 0.08])
def test_what_stands_raises_an_alert_and_clears_it_when_it_has_gone(slope):
    steps = [road((3.0, 2.0), slope, seed) for seed in range(15)] + [road(None, slope, 50 + seed) for seed in range(15)]
    (raised_at, raised), (cleared_at, cleared) = events(steps)
    assert (raised.raised, cleared.raised) == (True, False)
    assert raised_at == 9, "ten tenths of a second"
    assert 15 + 4 <= cleared_at <= 15 + 8, "five tenths seen free, and a few in which a cell was not seen"
    assert raised.position_m == pytest.approx((5.0, 2.9), abs=0.5)
    assert 3.5 <= raised.size_m[0] <= 5.0
    assert raised.vehicles == ("a",)
    assert cleared.since_ns == raised.since_ns


@pytest.mark.sweep
def test_what_passes_raises_none():
    """Five metres a second: nine tenths over any place."""
    steps = [road((-5.0 + 0.5 * number, 2.0), seed=number) for number in range(35)]
    assert events(steps) == []
    assert events(steps, vehicles=("a", "b")) == [], "also when two vehicles see it"


def test_what_is_hidden_for_a_moment_is_not_forgotten():
    nothing = np.zeros((0, 3))
    steps = [road((3.0, 2.0), seed=seed) for seed in range(6)] + [nothing] * 5
    steps += [road((3.0, 2.0), seed=seed) for seed in range(6)] + [nothing] * 50
    ((at, raised),) = events(steps)
    assert raised.raised
    assert at == 6 + 5 + 3
    later = [*steps, *[nothing] * 60]
    assert [event.raised for _, event in events(later)] == [True, False], "but not for ever: ten seconds"


def test_what_flickers_neither_raises_nor_clears_each_time():
    standing = [road((3.0, 2.0), seed=seed) for seed in range(12)]
    flicker = [road((3.0, 2.0) if seed % 3 else None, seed=seed) for seed in range(30)]
    assert [event.raised for _, event in events(standing + flicker)] == [True]


@pytest.mark.sweep
def test_what_stands_beside_the_zone_or_high_above_it_is_none():
    assert events([road((3.0, 7.0), seed=seed) for seed in range(20)]) == []
    bridge = np.column_stack([np.random.default_rng(1).uniform((0, 0), (10, 6), (500, 2)), np.full(500, 5.0)])
    assert events([np.concatenate([road(seed=seed), bridge]) for seed in range(20)]) == []


def test_the_ground_is_found_under_walls_and_not_where_nothing_is_seen():
    rng = np.random.default_rng(2)
    wall = np.column_stack([rng.uniform(-6, 16, 4000), np.full(4000, 9.0), rng.uniform(0, 8, 4000)])
    plane = zones.ground_plane(np.concatenate([road((3.0, 2.0), 0.05), wall]))
    assert plane == pytest.approx((0.05, 0.0, 0.0), abs=0.06)
    assert zones.ground_plane(np.zeros((0, 3))) is None
    assert zones.ground_plane(np.zeros((10, 3))) is None


@pytest.mark.sweep
def test_what_went_is_cleared_also_where_it_takes_longer_than_to_raise():
    """As with --stand 0.5: an alert that stays for ever is soon believed by nobody."""
    steps = [road((3.0, 2.0), seed=seed) for seed in range(8)] + [road(None, seed=50 + seed) for seed in range(20)]
    found = events(steps, rules=zones.Rules(stand=5, clear=8))
    assert [event.raised for _, event in found] == [True, False]


@pytest.mark.parametrize("corners", [[[0, 0], [1, 1]], [[0, 0, 0]] * 3, [], [[0, 0], [1, 1, 1], [2, 0]]])
def test_a_zone_needs_three_corners(corners):
    with pytest.raises(ValueError, match="three corners"):
        zones.Zone("z", corners)


@pytest.mark.parametrize(
    ("corners", "said"),
    [
        ([[0, 0], [4, 4], [4, 0], [0, 4]], "cross each other"),
        ([[0, 0], [10, 0], [10, 6], [5, -3], [0, 6]], "cross each other"),
        ([[5e6, 1], [5e6 + 1, 2], [5e6 + 2, 3]], "in a line"),
        ([[1, 1]] * 3, "in a line"),
        ([[0, 0], [1, float("nan")], [1, 1]], "are numbers"),
        ([[0, 0], [1e9, 0], [1e9, 1e9]], "at most 1000 m"),
    ],
)
def test_a_zone_is_an_area_that_can_be_watched(corners, said):
    """Of one that crosses itself a part would be watched, and nobody would know which."""
    with pytest.raises(ValueError, match=said):
        zones.Zone("z", corners)
    assert zones.Zone("z", [[5e6, 0], [5e6 + 9, 0], [5e6 + 9, 5], [5e6 + 4, 1]]).alert is False


class Again(PacketSource):
    """A few frames of a simulated drive over and over, with the places at which they were made."""

    def __init__(self, spec: str) -> None:
        with open_source(spec) as source:
            self._packets = list(source.packets())
            self._poses = source.poses
            super().__init__(source.sensor)
        self._first_ns = self._packets[0].stamp_ns
        self._period_ns = self._packets[-1].stamp_ns - self._first_ns + 288_000

    def packets(self) -> Iterator[Packet]:
        turn = 0
        while not self.closed:
            for payload, stamp_ns, _ in self._packets:
                yield Packet(payload, stamp_ns + turn * self._period_ns)
            turn += 1

    def at(self, stamp_ns: int) -> np.ndarray | None:
        return self._poses.at(self._first_ns + (stamp_ns - self._first_ns) % self._period_ns)


def frames_seen(states: list[dict], stream: str) -> int:
    """How many frames of `stream` the newest state counts: 0 while no state has it, as one vehicle may start later."""
    return states[-1]["vehicles"].get(stream, {"frames": 0})["frames"] if states else 0


@pytest.mark.sweep
@pytest.mark.timeout(600)
def test_two_vehicles_watch_a_street_over_zenoh(tmp_path):
    """Parked cars at the kerb raise an alert, the free road beside them none, seen from both vehicles."""
    mcap_protobuf = pytest.importorskip("mcap_protobuf.decoder", reason="read back by mcap-protobuf-support")
    port, out = free_port(), tmp_path / "alerts.mcap"
    command = [sys.executable, str(MONITOR), "car-1/lidar", "car-2/lidar", "--name", "test", "--stand", "0.5"]
    command += ["--zone", "kerb=14,1.5 24,1.5 24,5 14,5", "--zone", "road=6,-2 12,-2 12,0.4 6,0.4", "--out", str(out)]
    variables = {"LIDARCODEC_LOOPBACK_PORT": str(port)}
    heard: dict[str, list[dict]] = {"alert": [], "state": []}
    cars = [Again("sim:street?seed=1&frames=2"), Again("sim:street?seed=1&frames=2&skip=15")]
    settings = StreamSettings(max_error_m=0.02, intensity="off")
    endpoints = Endpoints(loopback_port=port)
    with open_transport(endpoints) as office:
        office.listen("lidarcodec/v2x/test/*", lambda key, data: heard[key.rpartition("/")[2]].append(json.loads(data)))
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment(**variables))
        try:
            with (
                Publisher(cars[0], settings, vehicle="car-1", endpoints=endpoints, poses=cars[0], rate=10.0),
                Publisher(cars[1], settings, vehicle="car-2", endpoints=endpoints, poses=cars[1], rate=10.0),
            ):
                assert eventually(lambda: heard["alert"], LIMIT_S)
                # The road has been looked at for as long by then; give it as long again.
                seen = frames_seen(heard["state"], "car-1/lidar")
                assert eventually(lambda: frames_seen(heard["state"], "car-1/lidar") > seen + 8, LIMIT_S)
        finally:
            process.send_signal(signal.SIGTERM)
            said, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0
    assert {(alert["zone"], alert["raised"]) for alert in heard["alert"]} == {("kerb", True)}
    assert [json.loads(line) for line in said.splitlines()] == heard["alert"]
    (x, y), state = heard["alert"][0]["position_m"], heard["state"][-1]
    assert 14 <= x <= 24
    assert 1.5 <= y <= 5
    assert {zone["name"]: zone["alert"] for zone in state["zones"]} == {"kerb": True, "road": False}
    assert set(state["vehicles"]) == {"car-1/lidar", "car-2/lidar"}
    assert all(one["without_pose"] == 0 for one in state["vehicles"].values())

    reader = make_reader(out.open("rb"), decoder_factories=[mcap_protobuf.DecoderFactory()])
    alerts = [json.loads(message.data) for _, _, message in reader.iter_messages(topics=["alerts"])]
    assert alerts == heard["alert"]
    clouds = [content for *_, content in reader.iter_decoded_messages(topics=["things"])]
    things = np.frombuffer(clouds[-1].data, module("outputs").foxglove.POINT_DTYPE)
    assert clouds[-1].frame_id == "world"
    assert len(things) > 50
    assert things["x"].min() >= 14
    assert things["x"].max() <= 24
    assert 0.1 < things["z"].min() < things["z"].max() < 3.5


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["a/b", "--zone", "z=1,2 3"], 2, "NAME=x,y"),
        marked((["a/b", "a/b", "--zone", "z=0,0 4,0 4,4"], 2, "a/b is named twice"), pytest.mark.sweep),
        marked((["a", "--zone", "z=0,0 4,0 4,4"], 2, "'a' is not a stream"), pytest.mark.sweep),
        marked((["a/b", "--zone", "z=0,0 4,0 4,4", "--stand", "nan"], 2, "--stand"), pytest.mark.sweep),
        (["a/b", "--zone", "z=0,0 4,0 4,4", "--out", "/nowhere/alerts.mcap"], 1, "/nowhere/alerts.mcap"),
        (["a/b", "--zone", "z=0,0 4,0 4,4", "--connect", "nowhere"], 1, "'nowhere' is not an endpoint"),
    ],
)
def test_what_cannot_be_is_reported_at_once_in_a_line(words, code, said):
    command = [sys.executable, str(MONITOR), *words]
    refused = subprocess.run(command, capture_output=True, text=True, env=environment(), timeout=60, check=False)
    assert refused.returncode == code, refused.stderr
    assert said in refused.stderr.splitlines()[-1]
    assert "Traceback" not in refused.stderr
