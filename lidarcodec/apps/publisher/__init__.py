"""The publisher of a stream: source, encoder, network, and what receivers ask of it."""
