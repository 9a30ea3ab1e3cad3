"""`lidarcodec localise`: finds a sensor in a map, scan by scan."""
