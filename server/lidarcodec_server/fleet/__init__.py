"""The fleet: which streams there are, and what operators want of them."""
