"""The CLOUD section: a `sensor_msgs/PointCloud2` message (docs/wire-format-clouds.md)."""
