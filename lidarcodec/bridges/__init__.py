"""Bridges: they pass live streams to programs without support for lidarcodec, ROS 2 and Foxglove."""
