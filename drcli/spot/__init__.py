"""Training on machines of Amazon, and interruption notices."""
