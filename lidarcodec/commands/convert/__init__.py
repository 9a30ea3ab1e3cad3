"""`lidarcodec convert`: options, conversion, and output formats."""
