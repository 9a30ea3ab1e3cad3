"""`lidarcodec info`: a source, a recording, one message, or this installation."""
