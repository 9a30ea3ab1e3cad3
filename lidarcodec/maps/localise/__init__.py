"""Finds a sensor in a map. window: the tiles around it; tracker: its pose, scan by scan; search: its first pose;
starting: the places that a first pose may mean; evidence: what speaks for a place."""
