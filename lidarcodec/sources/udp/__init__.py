"""Live sensors: UDP sockets and the choice of the sender."""
