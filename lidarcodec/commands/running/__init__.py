"""Running, stopping and ending a command."""
