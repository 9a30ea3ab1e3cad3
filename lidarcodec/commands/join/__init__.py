"""`lidarcodec join`: captures or recordings."""
