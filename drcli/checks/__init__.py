"""Checks before a start, and the sandbox that tries reward functions."""
