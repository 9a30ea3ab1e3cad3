"""Ranges as video: the canvas of a turn, and streams of H.264."""
