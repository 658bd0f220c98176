"""Tracks: geometry, worlds by name, route files, and what a world looks like."""
