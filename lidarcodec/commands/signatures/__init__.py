"""Arguments and options of each command. Its work is in the module that it calls."""
