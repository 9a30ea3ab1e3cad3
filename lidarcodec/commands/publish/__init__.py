"""`lidarcodec publish`: publishes a source, or several sensors from a configuration file."""
