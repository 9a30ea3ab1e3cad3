"""What all codecs send beside ranges: mask, intensity, azimuth, side information, calibration, pose."""
