"""`lidarcodec certs`: a certificate authority and its files."""
