"""How a sensor moved, and what is expected of a frame by what was seen before."""
