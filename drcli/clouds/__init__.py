"""Clouds, and how each announces that it takes a machine away."""
