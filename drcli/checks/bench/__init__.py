"""Measures how fast this machine trains."""
