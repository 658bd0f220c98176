"""Tracks: geometry, worlds by name, route files, and appearance."""
