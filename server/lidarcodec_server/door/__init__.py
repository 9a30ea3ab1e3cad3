"""The door: accepts connections, limits their number, and sets up TLS, before HTTP."""
