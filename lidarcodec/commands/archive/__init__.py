"""`lidarcodec archive`: recordings of a fleet in a folder or in object storage."""
