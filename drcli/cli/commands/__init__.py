"""The commands. Heavy imports belong into their functions."""
