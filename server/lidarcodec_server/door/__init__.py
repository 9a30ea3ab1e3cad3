"""The door: how connections come in, which are kept, and what they meet before HTTP."""
