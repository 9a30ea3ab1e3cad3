"""The server, tested as an ASGI application and as a process."""
