"""Decodes a coded topic for nodes that know no transports: NAME/lidarcodec in, NAME_decoded out.

ros2 launch lidarcodec_point_cloud_transport decode.launch.py points:=/car_7/roof/points
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """The node `republish` of point_cloud_transport, from this transport to plain PointCloud2."""
    points = LaunchConfiguration("points")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "points", default_value="/points", description="topic of the points, without /lidarcodec"
            ),
            Node(
                package="point_cloud_transport",
                executable="republish",
                name="lidarcodec_decoded",
                parameters=[{"in_transport": "lidarcodec", "out_transport": "raw"}],
                remappings=[("in/lidarcodec", [points, "/lidarcodec"]), ("out", [points, "_decoded"])],
                output="screen",
            ),
        ]
    )
