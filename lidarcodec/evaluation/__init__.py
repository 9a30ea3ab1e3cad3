"""Measures bits, times and errors of codecs. All messages are really decoded."""
