"""Without these rviz sees no topic, or a topic and no cloud: keys, tokens and attachments must be ROS 2's own."""

from __future__ import annotations

import struct

import pytest

from lidarcodec.bridges.rmw_zenoh import Node, Publisher, checked_topic, topic_name
from lidarcodec.errors import SettingsError
from lidarcodec.interop.ros import POINT_CLOUD2, RosType

CHATTER = RosType(
    "std_msgs/msg/String",
    "string data\n",
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
)
SESSION = "8b20917502ee955ac4476e0266340d5c"


def test_tokens_and_keys_are_those_that_ros_documents() -> None:
    """The examples of rmw_zenoh's docs/design.md, its numbers of entities apart."""
    node = Node("talker", 0, SESSION)
    assert node.token == f"@ros2_lv/0/{SESSION}/0/0/NN/%/%/talker"
    talker = Publisher(node, 10, "/chatter", CHATTER, depth=7)
    assert talker.token == (
        f"@ros2_lv/0/{SESSION}/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/{CHATTER.type_hash}/::,7:,:,:,,"
    )
    assert talker.key == f"0/chatter/std_msgs::msg::dds_::String_/{CHATTER.type_hash}"


def test_a_topic_of_several_parts_is_a_key_of_several_and_one_part_of_a_token() -> None:
    points = Publisher(Node("a", 42, "1f"), 1, "/car_7/roof/points", POINT_CLOUD2)
    assert points.key == f"42/car_7/roof/points/sensor_msgs::msg::dds_::PointCloud2_/{POINT_CLOUD2.type_hash}"
    assert points.token.split("/")[9] == "%car_7%roof%points"
    assert len(points.token.split("/")) == 13


def test_humble_knows_no_hashes() -> None:
    points = Publisher(Node("a", 0, "1f", type_hashes=False), 1, "/points", POINT_CLOUD2)
    assert points.key.endswith("/TypeHashNotSupported")
    assert "/TypeHashNotSupported/" in points.token


def test_what_is_attached_is_number_time_and_the_hash_of_the_token() -> None:
    xxhash = pytest.importorskip("xxhash", reason="hashes of tokens (extra `bridges`)")
    points = Publisher(Node("talker", 0, SESSION), 10, "/chatter", CHATTER, depth=7)
    data = points.attachment(3, 1_700_000_000_000_000_001)
    number, stamp_ns, length = struct.unpack_from("<qqB", data)
    assert (len(data), number, stamp_ns, length) == (33, 3, 1_700_000_000_000_000_001, 16)
    assert data[17:][::-1].hex() == xxhash.xxh3_128_hexdigest(points.token.encode())


@pytest.mark.parametrize(
    ("parts", "topic"),
    [
        (("car-7", "roof", "points"), "/car_7/roof/points"),
        (("2", "...", "points"), "/n2/n/points"),
        (("a--b", "_x_", "points"), "/a_b/x/points"),
    ],
)
def test_any_name_of_ours_becomes_a_topic_of_ros(parts: tuple[str, ...], topic: str) -> None:
    assert topic_name(*parts) == topic
    assert checked_topic(topic) == topic


@pytest.mark.parametrize("topic", ["points", "/", "/a/", "/1st", "/a b", "/a//b", "/a__b", "/a*", "/ä"])
def test_other_topics_are_refused(topic: str) -> None:
    with pytest.raises(SettingsError):
        checked_topic(topic)


def test_other_domains_are_refused() -> None:
    with pytest.raises(SettingsError, match="232"):
        Node("a", 233, "1")
