"""Live streams for viewers: one decoder a stream, newest only, and a slow viewer does not slow down others."""
