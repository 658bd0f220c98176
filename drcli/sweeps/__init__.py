"""Sweeps: several trainings that differ in what a file says, and the best of them."""
