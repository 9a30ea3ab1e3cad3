"""The work of each subcommand; `lidarcodec.cli` imports a module only when its command is called."""
