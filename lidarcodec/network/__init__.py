"""Networks of codec `riddle`: weights, their files and updates, and what goes on learning. No torch."""
