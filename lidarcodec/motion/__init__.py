"""How a sensor moved, and the ranges that a frame is expected to have after that motion."""
