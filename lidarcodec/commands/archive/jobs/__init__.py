"""Jobs of an archive that stand on other commands: formats of frames, and maps."""
