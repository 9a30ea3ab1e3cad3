"""The fleet: the known streams, and the settings that operators want for them."""
