"""What of a source is taken: which frames, and which of their points, placed where."""
