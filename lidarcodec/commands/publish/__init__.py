"""`lidarcodec publish`: a source, or several sensors by a file."""
