"""Ouster OS0, OS1, OS2 and OSDome: packets, metadata and points."""
