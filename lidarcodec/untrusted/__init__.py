"""What comes from elsewhere. Readers of JSON, YAML and NumPy's files refuse what costs more than it may; `text` makes
texts that steer no terminal."""
