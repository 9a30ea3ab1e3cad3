"""How a command is run, stopped and ended."""
