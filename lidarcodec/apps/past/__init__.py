"""What a vehicle keeps of its sensors, questions about it, and fetching parts of it."""
