"""`lidarcodec join`: joins captures or recordings."""
