"""Checks, plots and compares reward functions."""
