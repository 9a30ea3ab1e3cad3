"""Maps on the network: `shelf` and `answers` serve tiles, `tiles` keeps those around a place, `fetching` gets maps."""
