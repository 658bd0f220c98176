"""Sweeps: trainings that differ as a file says, and the best of them."""
