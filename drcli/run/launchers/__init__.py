"""Places worker processes with Ray."""
