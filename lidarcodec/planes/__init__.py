"""Sections of all codecs except ranges: mask, intensity, azimuth, side information, calibration, pose."""
