"""Records that the processes of a run exchange, and their encoding."""
