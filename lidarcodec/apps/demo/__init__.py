"""The whole system on one machine, for `lidarcodec demo`."""
