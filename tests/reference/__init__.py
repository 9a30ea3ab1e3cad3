"""Twins of native code in pure Python: the same bytes, to read and to test by."""
