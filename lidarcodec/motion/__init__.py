"""The motion of a sensor, and the expected ranges of a frame after that motion."""
