"""Tracks as a racer handles them: list, show, add, fetch."""
