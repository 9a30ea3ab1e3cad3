"""Ranges as an image: how cells lie on it, what stands in holes, and the files of image codecs."""
