"""Without these Foxglove connects and shows nothing, something else, or what was long ago."""

from __future__ import annotations

import json
import logging
import signal
import struct
import time

import jsonschema
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.errors import TransportError
from lidarcodec.mounting import Mounting
from lidarcodec.settings import StreamSettings
from tests.apps.streams import Loop
from tests.bridges.standing import POSE, Standing, turn
from tests.command_line import run_here, start
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

pytest.importorskip("foxglove", reason="serves Foxglove (extra `bridges`)")
pytest.importorskip("foxglove_schemas_protobuf", reason="read back by foxglove-schemas-protobuf")
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

from lidarcodec.bridges.foxglove import STATISTICS_SCHEMA, FoxgloveBridge
from tests.interop.test_foxglove import points_in

LIMIT_S = 120.0
pytestmark = pytest.mark.timeout(400)  # seconds of work, minutes on a machine that others use too
MESSAGE_DATA = 1
HEAD = struct.Struct("<BIQ")


class Viewer:
    """A client of Foxglove's WebSocket protocol, by its specification. channels: advertised, by topic."""

    def __init__(self, url: str) -> None:
        self._connection = connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None, compression=None, legacy=True)
        self.channels: dict[str, dict] = {}
        self._topics: dict[int, str] = {}

    def _receive(self, timeout_s: float) -> tuple[str, int, bytes] | None:
        data = self._connection.recv(timeout=timeout_s)
        if isinstance(data, str):
            message = json.loads(data)
            for channel in message.get("channels", []) if message["op"] == "advertise" else []:
                self.channels[channel["topic"]] = channel
            return None
        opcode, subscription, log_time = HEAD.unpack_from(data)
        assert opcode == MESSAGE_DATA
        return self._topics[subscription], log_time, data[HEAD.size :]

    def wait_for(self, *topics: str) -> None:
        """Until these are advertised."""
        end = time.monotonic() + LIMIT_S
        while not set(topics) <= set(self.channels):
            self._receive(end - time.monotonic())

    def subscribe(self, *topics: str) -> None:
        self.wait_for(*topics)
        wanted = []
        for topic in topics:
            self._topics[number := len(self._topics) + 1] = topic
            wanted.append({"id": number, "channelId": self.channels[topic]["id"]})
        self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def messages(self, count: int) -> dict[str, list[tuple[int, bytes]]]:
        """At least so many of every topic that was subscribed to."""
        found: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in self._topics.values()}
        end = time.monotonic() + LIMIT_S
        while min(map(len, found.values())) < count:
            got = self._receive(end - time.monotonic())
            if got is not None:
                found[got[0]].append(got[1:])
        return found

    def close(self) -> None:
        self._connection.close()


def test_cloud_pose_and_statistics_get_to_a_viewer_point_for_point(network):
    cloud = turn().cloud()
    names = [f"/car-7/roof/{name}" for name in ("points", "pose", "statistics")]
    with (
        FoxgloveBridge(["car-7/roof"], port=0, transport=network()) as bridge,
        Publisher(Loop(), vehicle="car-7", sensor="roof", rate=5.0, transport=network(), poses=Standing()),
    ):
        viewer = Viewer(bridge.url)
        viewer.subscribe(*names)
        found = viewer.messages(2)
        latest: dict = {}
        while not (latest.get("codec") and latest["kbps"] and latest["latency_ms"]):  # they come to be known
            ((_, data), *_) = viewer.messages(1)[names[2]]
            latest = json.loads(data)
        viewer.close()
    cloud_channel, pose_channel, statistics_channel = (viewer.channels[name] for name in names)
    assert (cloud_channel["encoding"], cloud_channel["schemaName"]) == ("protobuf", "foxglove.PointCloud")
    assert (pose_channel["encoding"], pose_channel["schemaName"]) == ("protobuf", "foxglove.FrameTransform")
    assert (statistics_channel["encoding"], statistics_channel["schemaEncoding"]) == ("json", "jsonschema")
    for log_time, data in found[names[0]]:
        message = PointCloud.FromString(data)
        assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == log_time
        points = points_in(message)
        assert message.frame_id == "car-7/roof"
        for name in ("x", "y", "z", "intensity", "ring"):
            assert np.array_equal(points[name], cloud[name]), name
        assert 0 <= points["t_ns"].min() < points["t_ns"].max() < 10**9
    for _, data in found[names[1]]:
        pose = FrameTransform.FromString(data)
        assert (pose.parent_frame_id, pose.child_frame_id) == ("world", "car-7/roof")
        assert [getattr(pose.translation, axis) for axis in "xyz"] == POSE[:3, 3].tolist()
    for _, data in found[names[2]]:
        statistics = json.loads(data)
        jsonschema.validate(statistics, STATISTICS_SCHEMA)
        assert set(statistics) == set(STATISTICS_SCHEMA["properties"])
        assert (statistics["vehicle"], statistics["alive"]) == ("car-7", True)
    assert latest["codec"] == "pcodec"
    assert latest["frames"] > 0
    assert latest["replaced"] is not None


def test_a_mounting_gets_to_viewers_that_come_later_and_the_pose_is_the_vehicles(network):
    mount = Mounting(1.5, 0.0, 1.8, yaw_deg=90.0)
    names = [f"/car-7/roof/{name}" for name in ("mount", "pose")]
    with (
        FoxgloveBridge(["car-7/roof"], port=0, transport=network()) as bridge,
        Publisher(Loop(), vehicle="car-7", sensor="roof", rate=5.0, transport=network(), poses=Standing(), mount=mount),
    ):
        for _ in range(2):
            viewer = Viewer(bridge.url)
            viewer.subscribe(*names)
            found = viewer.messages(1)
            viewer.close()
    placed, posed = (FrameTransform.FromString(found[name][0][1]) for name in names)
    assert (placed.parent_frame_id, placed.child_frame_id) == ("car-7", "car-7/roof")
    assert (posed.parent_frame_id, posed.child_frame_id) == ("world", "car-7")
    wanted = POSE @ np.linalg.inv(mount.T_vehicle_sensor)
    for one, T in ((placed, mount.T_vehicle_sensor), (posed, wanted)):
        np.testing.assert_allclose([getattr(one.translation, axis) for axis in "xyz"], T[:3, 3], atol=1e-12)


@pytest.mark.parametrize("fill", [None, False])
def test_gaps_of_thinned_frames_are_filled_and_marked_or_not_filled(network, fill):
    """A wall of which every eighth column is sent is a wall for a person, and its columns for a program."""
    settings = StreamSettings(reduction="lattice:8")
    with (
        FoxgloveBridge(["car-7/roof"], port=0, transport=network(), fill=fill) as bridge,
        Publisher(Loop(), settings, vehicle="car-7", sensor="roof", rate=5.0, transport=network()),
    ):
        viewer = Viewer(bridge.url)
        topics = ("/car-7/roof/points", "/car-7/roof/statistics")
        viewer.subscribe(*topics)
        found = viewer.messages(2)
        latest: dict = {}
        while not latest.get("points"):
            ((_, data), *_) = viewer.messages(1)[topics[1]]
            latest = json.loads(data)
        viewer.close()
    jsonschema.validate(latest, STATISTICS_SCHEMA)
    for _, data in found[topics[0]]:
        points = points_in(PointCloud.FromString(data))
        if fill is None:
            measured = int((points["filled"] == 0).sum())
            assert points["filled"].sum() > 2 * measured
        else:
            assert "filled" not in points.dtype.names
            measured = len(points)
        assert 1_000 < measured < 4_000
        assert 1_000 < latest["points"] < 4_000
        assert (latest["made_up"] or 0) > 4_000 if fill is None else latest["made_up"] == 0


def test_nothing_is_made_of_a_stream_that_nobody_looks_at(network):
    with (
        FoxgloveBridge(["vehicle/lidar"], port=0, transport=network()) as bridge,
        Publisher(Loop(), rate=5.0, transport=network()),
    ):
        assert eventually(lambda: bridge.counts["unwatched"] >= 3, LIMIT_S)
        assert bridge.counts["clouds"] == 0
        viewer = Viewer(bridge.url)
        viewer.subscribe("/vehicle/lidar/points")
        assert viewer.messages(2)
        viewer.close()
        before = bridge.counts["unwatched"]
        assert eventually(lambda: bridge.counts["unwatched"] > before + 2, LIMIT_S)


def test_a_viewer_that_does_not_read_holds_nobody_up_and_sees_the_newest(network):
    with (
        FoxgloveBridge(["vehicle/lidar"], port=0, transport=network()) as bridge,
        Publisher(Loop(), rate=10.0, transport=network()),
    ):
        stuck, quick = Viewer(bridge.url), Viewer(bridge.url)
        stuck.subscribe("/vehicle/lidar/points")
        quick.subscribe("/vehicle/lidar/points")
        assert quick.messages(1)
        assert len(quick.messages(12)["/vehicle/lidar/points"]) >= 12  # what stuck does not take: 24 MB and more
        stuck.close()
        quick.close()


def test_a_viewer_cannot_fill_the_log(network, caplog):
    with FoxgloveBridge(["car-7/roof"], port=0, transport=network()) as bridge:
        viewer = Viewer(bridge.url)
        viewer.wait_for("/car-7/roof/points")
        wrong = [{"id": number, "channelId": 10**6 + number} for number in range(3000)]
        viewer._connection.send(json.dumps({"op": "subscribe", "subscriptions": wrong}))
        assert eventually(lambda: bridge.counts["complaints"] >= 3000)
        for number in range(200):  # words that a viewer chose
            logging.getLogger("foxglove.websocket").error("Invalid message: unknown variant %s", "x" * number)
        assert bridge.summary()["complaints"] >= 3200
        viewer.close()
    assert 2 <= len(caplog.records) <= 40
    logging.getLogger("foxglove.websocket").error("the bridge is closed")
    assert caplog.messages[-1] == "the bridge is closed"


def test_several_streams_are_told_apart_and_leave_when_it_ends(network):
    with FoxgloveBridge(["a/front", "a/rear"], port=0, transport=network()) as bridge:
        viewer = Viewer(bridge.url)
        viewer.wait_for(*(f"/a/{side}/{what}" for side in ("front", "rear") for what in ("points", "statistics")))
        ids = {channel["id"] for channel in viewer.channels.values()}
        assert len(ids) == 8
    with pytest.raises(ConnectionClosed):
        viewer.wait_for("/never")
    bridge.close()


def test_a_port_that_is_taken_is_reported(network):
    with FoxgloveBridge(["a/b"], port=0, transport=network()) as first:
        second = FoxgloveBridge(["a/b"], port=first.port, transport=network())
        with pytest.raises(
            TransportError, match=f"cannot listen on 127.0.0.1:{first.port}: Address already in use; choose"
        ):
            second.__enter__()
        second.close()


def test_the_command_serves_until_a_signal():
    port = free_port()
    command = start("bridge", "foxglove", "vehicle/lidar", "--port", 0, "--connect", f"tcp/127.0.0.1:{port}", "--json")
    line = command.stderr.readline()
    assert line.startswith("open in Foxglove: ws://127.0.0.1:"), line
    from lidarcodec.transport import Endpoints

    with Publisher(Loop(), rate=5.0, endpoints=Endpoints.of(listen=f"tcp/127.0.0.1:{port}")):
        viewer = Viewer(line.split()[-1])
        viewer.subscribe("/vehicle/lidar/points")
        assert viewer.messages(2)
        command.send_signal(signal.SIGTERM)
        said, complained = command.communicate(timeout=LIMIT_S)
    assert command.returncode == 0, complained
    assert json.loads(said)["clouds"] >= 2


def test_what_cannot_be_is_reported_at_once():
    refused = run_here("bridge", "foxglove", "a/b", "a/b")
    assert (refused.returncode, "named twice" in refused.stderr) == (2, True)
