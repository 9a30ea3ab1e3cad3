"""Readers of what comes from elsewhere: JSON, YAML and NumPy's files. Each refuses what costs more than it may."""
