"""`lidarcodec certs`: a certificate authority and what it keeps."""
