"""Sweeps: trainings that differ as a file says."""
