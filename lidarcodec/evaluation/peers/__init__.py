"""Coders of other projects, measured on the same frames and with the same count of bits as our codecs. They exist only
for this comparison: lidarcodec sends no data in their formats."""
