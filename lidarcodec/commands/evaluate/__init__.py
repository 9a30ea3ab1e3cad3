"""`lidarcodec evaluate`: measures how useful decoded frames are, such as for localisation."""
