"""Tracks as a racer handles them: listing, looking, adding, fetching."""
