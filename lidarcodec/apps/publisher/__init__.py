"""The publisher of a stream: source, encoder, network, and control queries."""
