"""Clips of what vehicles kept: fetched in the background, and stored here."""
