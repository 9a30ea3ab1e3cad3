"""What each command takes: its arguments and options. What it does is in the module that it calls."""
