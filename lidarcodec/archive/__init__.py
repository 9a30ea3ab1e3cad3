"""An archive: recordings of many vehicles in a folder or in object storage, with an index of their frames.

The store holds the guarantee, not the engine that runs the work: a segment is coded at least once, and is visible
exactly once. docs/guides/archive.md describes the objects.
"""
