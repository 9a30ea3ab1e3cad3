"""`lidarcodec bench`, with its curves."""
