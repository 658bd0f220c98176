"""Races at home between models in the bucket."""
