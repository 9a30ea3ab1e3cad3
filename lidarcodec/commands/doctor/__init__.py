"""`lidarcodec doctor`: what this machine offers, and what on it does not work."""
