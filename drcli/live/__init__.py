"""What workers show while somebody watches: records, scenes, the server, and the feed."""
