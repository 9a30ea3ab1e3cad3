"""Live sensors: sockets and the choice of the sender."""
