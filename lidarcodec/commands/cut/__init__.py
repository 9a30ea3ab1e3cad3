"""`lidarcodec cut`: copies a part of a capture or a recording, or splits it."""
