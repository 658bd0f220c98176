"""Checks, tries, plots and compares reward functions."""
