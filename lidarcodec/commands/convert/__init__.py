"""`lidarcodec convert`: options, work, and what it writes."""
