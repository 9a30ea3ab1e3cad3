"""Formats that commands write frames in, a file each; `table.py` lists them."""
