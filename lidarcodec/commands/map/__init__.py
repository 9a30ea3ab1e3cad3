"""`lidarcodec map`: builds, compresses, describes and exports maps for localisation."""
