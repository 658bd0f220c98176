"""The process in which a racer's code is tried, and what is learned from it."""
