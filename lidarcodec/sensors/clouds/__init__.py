"""Point clouds that come as `sensor_msgs/PointCloud2` messages: what is in a message, and its range image."""
