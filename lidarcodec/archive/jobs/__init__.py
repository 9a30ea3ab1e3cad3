"""The work of an archive: a file for each kind of task."""
