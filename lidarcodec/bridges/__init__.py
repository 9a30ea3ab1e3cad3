"""Live streams handed on to programs that know nothing of lidarcodec: ROS 2 and Foxglove."""
