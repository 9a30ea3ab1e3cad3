"""Speed, size and memory, kept as history: `make bench` adds a line, `make bench-compare` compares with the last."""
