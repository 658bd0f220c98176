"""Spot machines: notices of an interruption, and instances in the cloud of Amazon."""
