"""What each subcommand does; `lidarcodec.cli` imports a module only when its command is called."""
