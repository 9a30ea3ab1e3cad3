"""Messages and what has to come out of them, for decoders in other languages (clients/typescript, clients/web)."""
