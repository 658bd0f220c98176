"""Checks before a start: rules by subject, and the sandbox that tries a racer's code."""
