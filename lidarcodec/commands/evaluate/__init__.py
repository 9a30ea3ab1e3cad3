"""`lidarcodec evaluate`: what a stream is good for at its receiver."""
