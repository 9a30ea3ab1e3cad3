"""Types of ROS 2 messages: names, what is in them, and the hash by which nodes know that they mean the same.

The hash (RIHS01, REP 2016) is over the type's description; the tests compute it again with `rosbags`.
"""

from __future__ import annotations

from typing import Final, NamedTuple

_RULE: Final = "=" * 80
_PARTS: Final = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "sensor_msgs/PointField": "".join(
        f"uint8 {name}={number}\n"
        for number, name in enumerate(
            ("INT8", "UINT8", "INT16", "UINT16", "INT32", "UINT32", "FLOAT32", "FLOAT64"), start=1
        )
    )
    + "string name\nuint32 offset\nuint8 datatype\nuint32 count\n",
    "velodyne_msgs/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
}


class RosType(NamedTuple):
    """A type: its name, its definition with those of all that is in it, and its hash."""

    name: str
    definition: str
    type_hash: str

    @property
    def dds_name(self) -> str:
        """The name that ROS 2 gives it on the network."""
        package, _, name = self.name.partition("/msg/")
        return f"{package}::msg::dds_::{name}_"


def _defined(own: str, *parts: str) -> str:
    return own + "".join(f"{_RULE}\nMSG: {part}\n{_PARTS[part]}" for part in parts)


POINT_CLOUD2: Final = RosType(
    "sensor_msgs/msg/PointCloud2",
    _defined(
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
        "std_msgs/Header",
        "builtin_interfaces/Time",
        "sensor_msgs/PointField",
    ),
    "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
)
COMPRESSED_CLOUD: Final = RosType(
    "point_cloud_interfaces/msg/CompressedPointCloud2",
    _defined(
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
        "uint32 point_step\nuint32 row_step\nuint8[] compressed_data\nbool is_dense\nstring format\n",
        "std_msgs/Header",
        "builtin_interfaces/Time",
        "sensor_msgs/PointField",
    ),
    "RIHS01_4b38df4932a156a54c53e80a7f34e54e2966b20e54a4d14ded34a165a389c0c1",
)
VELODYNE_SCAN: Final = RosType(
    "velodyne_msgs/msg/VelodyneScan",
    _defined(
        "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
        "std_msgs/Header",
        "builtin_interfaces/Time",
        "velodyne_msgs/VelodynePacket",
    ),
    "RIHS01_4e4edd7152e8bd604311d8b2e68e4c1b0771c8ce72700de79f6d1418aa242b3c",
)
TF_MESSAGE: Final = RosType(
    "tf2_msgs/msg/TFMessage",
    _defined(
        "geometry_msgs/TransformStamped[] transforms\n",
        "geometry_msgs/TransformStamped",
        "std_msgs/Header",
        "builtin_interfaces/Time",
        "geometry_msgs/Transform",
        "geometry_msgs/Vector3",
        "geometry_msgs/Quaternion",
    ),
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
)
