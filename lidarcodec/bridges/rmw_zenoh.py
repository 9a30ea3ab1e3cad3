"""How ROS 2 speaks over Zenoh (middleware rmw_zenoh_cpp, its docs/design.md): keys, tokens, and what is attached.

A publisher puts CDR on `DOMAIN/TOPIC/TYPE/HASH`, and shows itself by a liveliness token, from which every node makes
its picture of the graph. Attached to a message are its number, its time and the publisher's id, a hash of that token.

>>> from lidarcodec.interop.ros import POINT_CLOUD2
>>> node = Node("lidarcodec", domain=7, session="ab12")
>>> node.token
'@ros2_lv/7/ab12/0/0/NN/%/%/lidarcodec'
>>> Publisher(node, 1, "/car_7/roof/points", POINT_CLOUD2).key.partition("/RIHS01")[0]
'7/car_7/roof/points/sensor_msgs::msg::dds_::PointCloud2_'
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from lidarcodec.errors import MissingExtraError, SettingsError
from lidarcodec.interop.ros import RosType

ADMIN_SPACE: Final = "@ros2_lv"
ROOT: Final = "/"
NO_HASH: Final = "TypeHashNotSupported"
"""Replaces the hash of a type in Humble, before ROS 2 Iron."""
MAX_DOMAIN: Final = 232
_ATTACHMENT: Final = struct.Struct("<qqB16s")
_NAME: Final = re.compile(r"(/[A-Za-z][A-Za-z0-9_]*)+")


def mangled(name: str) -> str:
    """A name as one part of a key."""
    return name.replace("/", "%")


def topic_name(*parts: str) -> str:
    """A topic of these names. Characters that ROS does not allow become `_`; a leading digit gets an `n` before it.

    >>> topic_name("car-7", "2nd.roof", "points")
    '/car_7/n2nd_roof/points'
    """
    cleaned = (re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", part)).strip("_") or "n" for part in parts)
    return "".join(f"/n{part}" if part[0].isdigit() else f"/{part}" for part in cleaned)


def checked_topic(topic: str) -> str:
    """The topic itself.

    Raises SettingsError if ROS knows no such names.
    """
    if not _NAME.fullmatch(topic) or "__" in topic:
        raise SettingsError(f"'{topic}' is not a ROS topic: write /parts/of_letters_and_digits", "topic")
    return topic


@dataclass(frozen=True)
class Node:
    """A node of ROS in the root namespace; session: the id of its Zenoh session."""

    name: str
    domain: int
    session: str
    type_hashes: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= MAX_DOMAIN:
            raise SettingsError(f"a ROS domain is a number from 0 to {MAX_DOMAIN}, not {self.domain}", "domain")

    @property
    def token(self) -> str:
        """Liveliness token of the node itself."""
        return f"{ADMIN_SPACE}/{self.domain}/{self.session}/0/0/NN/{mangled(ROOT)}/{mangled(ROOT)}/{self.name}"


@dataclass(frozen=True)
class Publisher:
    """A publisher of a node: reliable, volatile, keeping the last `depth`. number: its own in that session, from 1."""

    node: Node
    number: int
    topic: str
    type: RosType
    depth: int = 1

    @property
    def type_hash(self) -> str:
        """Hash of the type, as keys have it."""
        return self.type.type_hash if self.node.type_hashes else NO_HASH

    @property
    def key(self) -> str:
        """Key of its messages."""
        return f"{self.node.domain}/{self.topic.strip('/')}/{self.type.dds_name}/{self.type_hash}"

    @property
    def token(self) -> str:
        """Its liveliness token. Qualities of service are numbers; defaults are left out."""
        node = self.node
        names = f"{mangled(ROOT)}/{mangled(ROOT)}/{node.name}/{mangled(self.topic)}/{self.type.dds_name}"
        entity = f"{ADMIN_SPACE}/{node.domain}/{node.session}/0/{self.number}/MP"
        return f"{entity}/{names}/{self.type_hash}/::,{self.depth}:,:,:,,"

    @cached_property
    def gid(self) -> bytes:
        """The 16 bytes by which ROS knows it: XXH3-128 of the token, the lower half first.

        Raises MissingExtraError.
        """
        try:
            import xxhash
        except ImportError:
            raise MissingExtraError("the bridge to ROS 2", "bridges") from None
        return int(xxhash.xxh3_128_intdigest(self.token.encode())).to_bytes(16, "little")

    def attachment(self, number: int, stamp_ns: int) -> bytes:
        """Attachment of a message. number: of the message, counted from 1; stamp_ns: when it is sent"""
        return _ATTACHMENT.pack(number, stamp_ns, len(self.gid), self.gid)
