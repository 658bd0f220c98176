"""The process that tries a reward function."""
