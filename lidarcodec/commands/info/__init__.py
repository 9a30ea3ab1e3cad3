"""`lidarcodec info`: describes a source, a recording, one message, or this installation."""
