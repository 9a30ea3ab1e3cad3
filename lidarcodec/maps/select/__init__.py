"""Ways to choose the points of a map that are kept; `table.py` names them."""
