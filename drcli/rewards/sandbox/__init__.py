"""The separate process that tries a reward function, and its records."""
