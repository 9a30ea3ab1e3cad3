"""Engines: what runs the tasks of an archive. Each has a file, and a line in `table.py`."""
