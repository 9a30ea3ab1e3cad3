"""Plays a bag of coded messages and shows it in rviz2, which decodes.

lidarcodec convert drive.mcap bag --as messages
ros2 launch lidarcodec_point_cloud_transport play.launch.py bag:=bag
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """`ros2 bag play`, and rviz2: add a PointCloud2 display with topic /points/lidarcodec."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="folder or file that `lidarcodec convert --as messages` wrote"),
            DeclareLaunchArgument("rate", default_value="1.0", description="how fast it is played"),
            ExecuteProcess(
                cmd=[
                    "ros2",
                    "bag",
                    "play",
                    LaunchConfiguration("bag"),
                    "--rate",
                    LaunchConfiguration("rate"),
                    "--clock",
                ],
                output="screen",
            ),
            Node(package="rviz2", executable="rviz2", parameters=[{"use_sim_time": True}], output="screen"),
        ]
    )
