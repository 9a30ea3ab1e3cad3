"""Rosbags of ROS 2, in MCAP or SQLite."""
