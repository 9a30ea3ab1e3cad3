"""Files: inputs are regular files, outputs are there whole or not at all, renames take nobody's place."""
