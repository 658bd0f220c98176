"""Models: list, upload, download, continue from another one, repair."""
