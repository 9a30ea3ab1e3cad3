"""What a user loses if these fail: the clouds of his ROS 2 nodes, live, over the network that rmw_zenoh makes."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from lidarcodec.bridges.rmw_zenoh import Node, Publisher
from lidarcodec.bridges.ros_source import WAITING, RosSource
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.interop.foxglove import points_of
from lidarcodec.interop.point_cloud2 import cdr_of, point_cloud2
from lidarcodec.interop.ros import POINT_CLOUD2
from lidarcodec.pipeline import frames_of
from lidarcodec.sensors.clouds.message import MAX_MESSAGE
from lidarcodec.sources import open_source
from lidarcodec.transport import Endpoints, open_transport
from lidarcodec.transport.base import Priority
from lidarcodec.transport.memory import MemoryNetwork
from tests.point_clouds import STAMP_NS, message, ros1, velodyne
from tests.transport.conftest import free_port
from tests.transport.test_contract import eventually

MESSAGES = [message(velodyne(60, seed=n), stamp_ns=STAMP_NS + n * 10**8) for n in range(3)]
LIMIT_S = 60.0


def key(topic: str = "/lidar/points", *, hashes: bool = True, domain: int = 0) -> str:
    return Publisher(Node("driver", domain, "ab", hashes), 1, topic, POINT_CLOUD2).key


def sending(sender, stop: threading.Event, every_s: float = 0.05) -> threading.Thread:
    """A node that publishes the messages again and again."""

    def run() -> None:
        while not stop.is_set():
            for one in MESSAGES:
                sender.put(one)
                stop.wait(every_s)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


@pytest.mark.timeout(200)
@pytest.mark.parametrize("hashes", [True, False], ids=["hashes", "humble"])
def test_messages_of_a_node_come_as_it_sent_them(hashes):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    stop = threading.Event()
    with (
        open_transport(Endpoints.of(listen=endpoint, mode="router")) as router,
    ):
        node = sending(router.sender(key(hashes=hashes), Priority.EVERY_FRAME), stop)
        distribution = "" if hashes else "&distribution=humble"
        with open_source(f"ros2:/lidar/points?router={endpoint}&idle=30{distribution}") as source:
            assert source.live
            assert source.sensor.model == "pointcloud2"
            assert source.sensor.rows == 16
            frames = frames_of(source.packets(), source.sensor, "packets")
            came = [next(frames) for _ in range(4)]
        stop.set()
        node.join()
    payloads = [frame.side.odd_packets[0] for frame in came]
    assert all(payload in MESSAGES for payload in payloads)
    assert all(frame.stamp_ns == STAMP_NS + MESSAGES.index(p) * 10**8 for frame, p in zip(came, payloads, strict=True))


def test_a_topic_that_nobody_publishes_says_where_it_looked():
    with MemoryNetwork().transport() as here, pytest.raises(SourceError, match="distribution=humble"):
        RosSource("/nothing", idle_s=0.1, transport=here)
    with MemoryNetwork().transport() as here, pytest.raises(SettingsError, match="not a ROS topic"):
        RosSource("/no good", transport=here)


def test_what_nobody_reads_is_counted_and_the_newest_stay():
    network, stop = MemoryNetwork(), threading.Event()
    with network.transport() as there, network.transport() as here:
        node = sending(there.sender(key(), Priority.FRAMES), stop, every_s=0.002)
        source = RosSource("/lidar/points", idle_s=10.0, transport=here)
        time.sleep(0.3)
        stop.set()
        node.join()
        source.finish()
        packets = list(source.packets())
        assert len(packets) <= WAITING + 2
        assert source.counts["queue drops"] > 0
        source.close()


def test_messages_that_are_too_long_do_not_wait_in_memory():
    """A node of ROS may send a gigabyte; eight of them would wait."""
    network = MemoryNetwork()
    with network.transport() as there, network.transport() as here:
        sender = there.sender(key(), Priority.EVERY_FRAME)

        node = threading.Thread(target=lambda: eventually(lambda: sender.matching) and sender.put(MESSAGES[0]))
        node.start()
        source = RosSource("/lidar/points", idle_s=60.0, transport=here)
        node.join()
        sender.put(bytes(MAX_MESSAGE + 1))
        assert eventually(lambda: source._too_long)
        source.finish()
        assert [packet.payload for packet in source.packets()] == MESSAGES[:1]
        assert source.counts["too long"] == 1
        source.close()


def frame_of(payload: bytes):
    from lidarcodec.image_frame import cloud_frame
    from lidarcodec.sensors.clouds.sensor import cloud_sensor

    return cloud_frame(0, STAMP_NS, payload, cloud_sensor([payload]))


def test_bridges_show_the_message_with_its_own_fields():
    payload = MESSAGES[0]
    assert point_cloud2(frame_of(payload), "elsewhere") == payload
    assert point_cloud2(frame_of(ros1(payload)), "elsewhere") == payload
    points = points_of(frame_of(payload))
    assert points.dtype.names == ("x", "y", "z", "intensity", "ring", "t_ns", "time")
    assert np.array_equal(points["time"], velodyne(60, seed=0)["time"])
    with pytest.raises(Exception, match="is not a PointCloud2"):
        cdr_of(b"something else")


def test_frames_are_views_of_the_message_row_0_the_highest():
    frame = frame_of(MESSAGES[0])
    cloud = frame.cloud("all")
    assert frame.points == len(cloud) == len(velodyne(60, seed=0))
    lowest, highest = (cloud["z"][cloud["ring"] == ring].mean() for ring in (15, 0))
    assert lowest < 0 < highest
    assert set(cloud["return_number"].tolist()) == {1}
    ranges = np.sqrt(sum(cloud[axis].astype(float) ** 2 for axis in "xyz"))
    assert np.isclose(np.sort(frame.range[frame.range > 0]) * 0.001, np.sort(ranges), atol=0.001).all()
