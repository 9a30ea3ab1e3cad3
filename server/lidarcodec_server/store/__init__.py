"""The store: the data that survives a restart, and its database."""
