"""A small detector of our own, without torch: what it finds in original and decoded frames, and its precision."""
