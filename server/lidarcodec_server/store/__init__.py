"""The store: what has to survive a restart, and the database that it is in."""
