"""Without these a cloud does not get to rviz, or not as it left: over real Zenoh sessions, read by public packages."""

from __future__ import annotations

import json
import signal
import struct
import threading
import time

import numpy as np
import pytest
import zenoh

from lidarcodec import wire
from lidarcodec.apps.publisher.publisher import Publisher
from lidarcodec.bridges.ros2 import RosBridge, RosNames
from lidarcodec.errors import SettingsError
from lidarcodec.interop import ros
from lidarcodec.interop.compressed_cloud import message_of
from lidarcodec.mounting import Mounting
from lidarcodec.pipeline import StreamDecoder, StreamEncoder
from lidarcodec.recording import RosbagWriter
from lidarcodec.settings import StreamSettings
from lidarcodec.sources import open_source
from lidarcodec.transport import Endpoints, open_transport
from tests.apps.streams import Loop
from tests.bridges.standing import POSE, Standing, turn
from tests.command_line import run_here, start
from tests.point_clouds import STAMP_NS, message, velodyne
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

pytest.importorskip("rosbags.typesys", reason="read back by rosbags (extra `bridges`)")
pytest.importorskip("xxhash", reason="hashes of tokens (extra `bridges`)")
from tests.interop.test_ros import STORE, points_in

LIMIT_S = 120.0
pytestmark = pytest.mark.timeout(400)  # seconds of work, minutes on a machine that others use too


class Ros:
    """The side of ROS 2: a router, and a session as a node has it, which sees tokens and subscribes."""

    def __init__(self, port: int) -> None:
        self.endpoint = f"tcp/127.0.0.1:{port}"
        self.router = open_transport(Endpoints.of(listen=self.endpoint, mode="router"))
        config = zenoh.Config()
        for path, value in {
            "mode": "peer",
            "connect/endpoints": [self.endpoint],
            "listen/endpoints": ["tcp/127.0.0.1:0"],
            "scouting/multicast/enabled": False,
        }.items():
            config.insert_json5(path, json.dumps(value))
        self.session = zenoh.open(config)
        self.tokens: dict[str, bool] = {}
        self._watcher = self.session.liveliness().declare_subscriber("@ros2_lv/0/**", self._token, history=True)
        self.samples: list[tuple[str, bytes, bytes]] = []
        self._subscribers: list[zenoh.Subscriber] = []

    def _token(self, sample: zenoh.Sample) -> None:
        self.tokens[str(sample.key_expr)] = sample.kind == zenoh.SampleKind.PUT

    def subscribe(self, topic: str, kind: ros.RosType) -> None:
        """As a node does: domain, topic, type and hash in the key."""

        def came(sample: zenoh.Sample) -> None:
            self.samples.append((str(sample.key_expr), sample.payload.to_bytes(), sample.attachment.to_bytes()))

        key = f"0{topic}/{kind.dds_name}/{kind.type_hash}"
        self._subscribers.append(self.session.declare_subscriber(key, came))

    def of(self, kind: ros.RosType) -> list[tuple[bytes, bytes]]:
        """Data and attachments of a type."""
        return [(data, attached) for key, data, attached in list(self.samples) if kind.dds_name in key]

    def alive(self, kind: str) -> list[str]:
        """Tokens of nodes (NN) or publishers (MP) that are there."""
        return [token for token, alive in list(self.tokens.items()) if alive and token.split("/")[5] == kind]

    def published(self) -> list[str]:
        """Tokens of publishers that are there."""
        return self.alive("MP")

    def close(self) -> None:
        for one in self._subscribers:
            one.undeclare()
        self._watcher.undeclare()
        self.session.close()
        self.router.close()


@pytest.fixture
def graph():
    one = Ros(free_port())
    yield one
    one.close()


@pytest.fixture
def local():
    """Endpoints of our own side: a loopback port that nobody else has."""
    return Endpoints(loopback_port=free_port())


def test_a_cloud_gets_to_a_node_of_ros_point_for_point(graph, local):
    # Every eighth column: of whole turns the network loses more where nobody has time to read.
    settings = StreamSettings(reduction="columns:8")
    (message,) = StreamEncoder(settings).encode(turn())
    (frame,) = StreamDecoder().decode(message)
    cloud = frame.cloud()
    assert len(cloud) > 2_000
    points_topic = "/car_7/roof/points"
    graph.subscribe(points_topic, ros.POINT_CLOUD2)
    graph.subscribe("/tf", ros.TF_MESSAGE)
    names = RosNames(world="odom")
    with (
        RosBridge(["car-7/roof"], names, endpoints=local, ros=Endpoints.of(connect=graph.endpoint)) as bridge,
        Publisher(Loop(), settings, vehicle="car-7", sensor="roof", rate=5.0, endpoints=local, poses=Standing()),
    ):
        assert eventually(lambda: len(graph.of(ros.POINT_CLOUD2)) >= 3 and len(graph.of(ros.TF_MESSAGE)) >= 3, LIMIT_S)
        # Clouds and tokens come in threads of their own, and what was sent is counted behind that.
        assert eventually(lambda: len(graph.published()) == 4, LIMIT_S)
        assert eventually(lambda: bridge.counts["clouds"] >= 3, LIMIT_S)
        (token,) = [one for one in graph.published() if "::PointCloud2" in one]
        assert token.endswith(
            f"/%car_7%roof%points/{ros.POINT_CLOUD2.dds_name}/{ros.POINT_CLOUD2.type_hash}/::,1:,:,:,,"
        )
        assert eventually(lambda: len(graph.alive("NN")) == 1, LIMIT_S)
        summary = bridge.summary()
    assert summary["clouds"] >= 3
    assert summary["topics"] == {"car-7/roof": points_topic}
    numbers = []
    for data, attached in graph.of(ros.POINT_CLOUD2):
        message = STORE.deserialize_cdr(data, ros.POINT_CLOUD2.name)
        assert message.header.frame_id == "car-7/roof"
        points = points_in(message)
        for name in ("x", "y", "z", "intensity"):
            assert np.array_equal(points[name], cloud[name]), name
        assert np.array_equal(63 - points["ring"].astype(int), cloud["ring"])
        number, stamp_ns, length = struct.unpack_from("<qqB", attached)
        assert abs(time.time_ns() - stamp_ns) < 600 * 10**9
        assert (len(attached), length) == (33, 16)
        numbers.append(number)
    # ROS reports what is missing as lost. A network that nobody has time to read may lose some, the bridge none.
    assert numbers == sorted(set(numbers))
    assert numbers[-1] <= bridge.counts["clouds"]
    transforms = [struct.unpack_from("<q", attached)[0] for _, attached in graph.of(ros.TF_MESSAGE)]
    assert transforms == sorted(set(transforms))
    assert transforms[-1] <= bridge.counts["transforms"]
    for data, _ in graph.of(ros.TF_MESSAGE):
        (found,) = STORE.deserialize_cdr(data, ros.TF_MESSAGE.name).transforms
        assert (found.header.frame_id, found.child_frame_id) == ("odom", "car-7/roof")
        moved = found.transform.translation
        assert [moved.x, moved.y, moved.z] == POSE[:3, 3].tolist()
    assert eventually(lambda: not graph.published(), LIMIT_S), "ROS sees the publishers go"


def test_a_mounting_is_said_again_on_tf_static_and_the_pose_is_the_vehicles(graph, local):
    mount = Mounting(1.5, 0.0, 1.8, yaw_deg=90.0)
    graph.subscribe("/tf", ros.TF_MESSAGE)
    graph.subscribe("/tf_static", ros.TF_MESSAGE)
    settings = StreamSettings(reduction="columns:8")
    with (
        RosBridge(["car-7/roof"], endpoints=local, ros=Endpoints.of(connect=graph.endpoint)) as bridge,
        Publisher(
            Loop(), settings, vehicle="car-7", sensor="roof", rate=5.0, endpoints=local, poses=Standing(), mount=mount
        ),
    ):
        assert eventually(lambda: bridge.counts["mountings"] >= 2 and bridge.counts["transforms"] >= 1, LIMIT_S)
        assert eventually(lambda: len({key for key, *_ in graph.samples if "/tf" in key}) == 2, LIMIT_S)
    vehicle = POSE @ np.linalg.inv(mount.T_vehicle_sensor)
    for key, data, _ in graph.samples:
        (found,) = STORE.deserialize_cdr(data, ros.TF_MESSAGE.name).transforms
        static = "/tf_static/" in key
        names = ("car-7/base_link", "car-7/roof") if static else ("map", "car-7/base_link")
        assert (found.header.frame_id, found.child_frame_id) == names
        moved, wanted = found.transform.translation, mount.T_vehicle_sensor if static else vehicle
        np.testing.assert_allclose([moved.x, moved.y, moved.z], wanted[:3, 3], atol=1e-12)


def test_transforms_of_a_point_cloud_are_of_the_frame_in_its_message(graph, local, tmp_path, caplog):
    """They were of `car-7/roof`, in which no cloud is: RViz could not place any. --frame-id did nothing, silently."""
    path = tmp_path / "clouds.mcap"
    with path.open("wb") as file, RosbagWriter(file, points_topic="/points") as writer:
        for at in range(100):
            writer.write_message(STAMP_NS + at * 10**8, message(velodyne(20), stamp_ns=STAMP_NS + at * 10**8))
    graph.subscribe("/roof", ros.POINT_CLOUD2)
    graph.subscribe("/tf", ros.TF_MESSAGE)
    names = RosNames("/roof", "roof")
    with (
        RosBridge(["car-7/roof"], names, endpoints=local, ros=Endpoints.of(connect=graph.endpoint)),
        open_source(path) as source,
        Publisher(source, vehicle="car-7", sensor="roof", rate=5.0, endpoints=local, poses=Standing()),
    ):
        assert eventually(lambda: graph.of(ros.POINT_CLOUD2) and len(graph.of(ros.TF_MESSAGE)) > 1, LIMIT_S)
    cloud = STORE.deserialize_cdr(graph.of(ros.POINT_CLOUD2)[0][0], ros.POINT_CLOUD2.name)
    sent = [STORE.deserialize_cdr(data, ros.TF_MESSAGE.name).transforms[0] for data, _ in graph.of(ros.TF_MESSAGE)]
    assert cloud.header.frame_id == "lidar"
    assert {(one.header.frame_id, one.child_frame_id) for one in sent} == {("map", "lidar"), ("map", "roof")}
    assert "--frame-id is for coded messages only" in caplog.text


@pytest.mark.parametrize("fill", [False, True])
def test_gaps_are_filled_for_ros_only_when_asked_and_then_marked(graph, local, fill):
    """A localiser takes every point for a measured one."""
    graph.subscribe("/car_7/roof/points", ros.POINT_CLOUD2)
    settings = StreamSettings(reduction="lattice:8")
    ends = {"endpoints": local, "ros": Endpoints.of(connect=graph.endpoint)}
    with (
        RosBridge(["car-7/roof"], fill=fill, **ends) as bridge,
        Publisher(Loop(), settings, vehicle="car-7", sensor="roof", rate=5.0, endpoints=local),
    ):
        assert eventually(lambda: len(graph.of(ros.POINT_CLOUD2)) >= 2 and bridge.counts["clouds"] >= 2, LIMIT_S)
    summary = bridge.summary()
    assert (summary["made_up"] > 2 * summary["points"]) is fill
    for data, _ in graph.of(ros.POINT_CLOUD2):
        points = points_in(STORE.deserialize_cdr(data, ros.POINT_CLOUD2.name))
        assert ("filled" in points.dtype.names) is fill
        assert len(points) < 20_000 or (points["filled"] == 0).sum() < 20_000


def test_second_returns_that_clouds_lack_are_counted_and_said_once(graph, local, caplog):
    graph.subscribe("/car_7/roof/points", ros.POINT_CLOUD2)
    dual = open_source("sim:garage?sensor=vlp16&returns=dual")
    with (
        RosBridge(["car-7/roof"], endpoints=local, ros=Endpoints.of(connect=graph.endpoint)) as bridge,
        Publisher(dual, vehicle="car-7", sensor="roof", endpoints=local),
    ):
        assert eventually(lambda: bridge.counts["clouds"] >= 2, LIMIT_S)
    assert bridge.summary()["second_returns_left_out"] > 100
    assert sum("two returns of each beam" in one for one in caplog.messages) == 1


def test_nothing_is_made_while_nobody_looks(graph, local):
    names = RosNames(topic="/points", transforms=False)
    with (
        RosBridge(["vehicle/lidar"], names, endpoints=local, ros=Endpoints.of(connect=graph.endpoint)) as bridge,
        Publisher(Loop(), rate=5.0, endpoints=local),
    ):
        assert eventually(lambda: bridge.counts["unwatched"] >= 3, LIMIT_S)
        assert bridge.counts["clouds"] == 0
        graph.subscribe("/points", ros.POINT_CLOUD2)
        assert eventually(lambda: len(graph.of(ros.POINT_CLOUD2)) >= 2, LIMIT_S)
        assert eventually(lambda: len(graph.published()) == 2, LIMIT_S)


def test_coded_messages_get_to_a_node_as_they_are_and_decode(graph, local):
    """The node comes between two key messages, and gets one at once."""
    settings = StreamSettings(codec="predictive", reduction="columns:8", key_interval=1000)
    ends = {"endpoints": local, "ros": Endpoints.of(connect=graph.endpoint)}
    with (
        RosBridge(["car-7/roof"], **ends) as bridge,
        Publisher(Loop(), settings, vehicle="car-7", sensor="roof", rate=5.0, endpoints=local),
    ):
        assert eventually(lambda: bridge.counts["unwatched"] >= 3, LIMIT_S)
        graph.subscribe("/car_7/roof/points/lidarcodec", ros.COMPRESSED_CLOUD)
        assert eventually(lambda: any(wire.peek(one).key for one in messages(graph)), LIMIT_S)
        assert eventually(lambda: len(messages(graph)) >= 5, LIMIT_S)
    coded = [wire.unpack(one) for one in messages(graph)]
    first = next(number for number, one in enumerate(coded) if one.key)
    decoder = StreamDecoder()
    assert all(len(decoder.decode(one)) == 1 for one in coded[first:])
    assert [one.frame_index for one in coded] == sorted({one.frame_index for one in coded})
    assert bridge.summary()["coded"] >= len(coded)


def messages(graph: Ros) -> list[bytes]:
    """Messages of lidarcodec that came to the node."""
    return [message_of(data) for data, _ in graph.of(ros.COMPRESSED_CLOUD)]


def test_the_router_of_ros_may_come_later(local):
    port = free_port()
    bridge = RosBridge(["vehicle/lidar"], endpoints=local, ros=Endpoints.of(connect=f"tcp/127.0.0.1:{port}"))
    opened = threading.Event()

    def enter() -> None:
        with bridge:
            opened.set()
            bridge.wait(LIMIT_S)

    thread = threading.Thread(target=enter)
    thread.start()
    assert not opened.wait(1.0)
    late = Ros(port)
    try:
        assert opened.wait(LIMIT_S)
        assert eventually(lambda: len(late.published()) == 4, LIMIT_S)
        bridge.interrupt()
        thread.join(LIMIT_S)
        assert not thread.is_alive()
    finally:
        late.close()


def test_the_command_bridges_until_the_publishers_have_gone(graph):
    port = free_port()
    graph.subscribe("/lidar", ros.POINT_CLOUD2)
    words = ["bridge", "ros2", "vehicle/lidar", "--ros-connect", graph.endpoint, "--topic", "/lidar", "--until-end"]
    with Publisher(Loop(), rate=5.0, endpoints=Endpoints.of(listen=f"tcp/127.0.0.1:{port}")):
        process = start(*words, "--connect", f"tcp/127.0.0.1:{port}", "--json")
        assert eventually(lambda: len(graph.samples) >= 2, LIMIT_S)
    said, complained = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, complained
    assert json.loads(said)["clouds"] >= 2


def test_the_command_says_where_it_looks_for_ros_and_ends_without_having_found_it():
    """Both networks meet at the same port by default: whoever forgot to start ROS's router looks for the wrong one."""
    port = free_port()
    process = start("bridge", "ros2", "car-7/roof", "--ros-connect", f"tcp/127.0.0.1:{port}")
    line = process.stderr.readline()
    assert line == f"to ROS 2, domain 0, router tcp/127.0.0.1:{port}: /car_7/roof/points\n"
    assert "trying again" in process.stderr.readline()
    process.send_signal(signal.SIGTERM)
    said, complained = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, complained) == (0, "")
    assert said.startswith("0 clouds")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["vehicle"], "is not a stream"),
        (["a/b", "a/b"], "named twice"),
        (["a/b", "a/c", "--topic", "/points"], "a single stream"),
        (["a/b", "--topic", "points"], "not a ROS topic"),
        (["a-1/b", "a_1/b"], "same topic"),
        (["a/b", "--ros-connect", "nowhere"], "not an endpoint"),
    ],
)
def test_what_cannot_be_is_reported_at_once(words, said):
    refused = run_here("bridge", "ros2", *words)
    assert (refused.returncode, said in refused.stderr) == (2, True), refused.stderr


def test_the_domain_is_that_of_ros(monkeypatch):
    for wrong in ("many", "300", "\u00b2"):
        monkeypatch.setenv("ROS_DOMAIN_ID", wrong)
        refused = run_here("bridge", "ros2", "a/b")
        assert (refused.returncode, "ROS_DOMAIN_ID" in refused.stderr) == (2, True)
    with pytest.raises(SettingsError):
        RosBridge(["a/b"], RosNames(domain=300))
