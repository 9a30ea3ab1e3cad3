"""`lidarcodec train`: one file for each kind of network."""
