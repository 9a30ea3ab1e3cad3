"""An archive at the server: found by its index, and its segments fetched to be downloaded and played."""
