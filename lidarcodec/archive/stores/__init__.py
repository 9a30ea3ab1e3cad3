"""Folders and buckets with one interface."""
