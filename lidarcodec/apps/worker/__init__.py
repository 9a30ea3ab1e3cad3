"""Codecs in processes of their own; `python -m lidarcodec.apps.worker` is such a process."""
