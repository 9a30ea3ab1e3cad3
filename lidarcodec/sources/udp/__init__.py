"""Live sensors: sockets, and who sends to them."""
