"""What is left of labelled objects in decoded frames: ground, clusters, and sizes, without a network."""
