"""What a codec costs and what it loses, measured on messages that were really decoded."""
