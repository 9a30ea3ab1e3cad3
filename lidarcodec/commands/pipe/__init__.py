"""`lidarcodec pipe`: standard input to standard output, frame by frame."""
