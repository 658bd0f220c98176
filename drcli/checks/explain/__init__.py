"""Explains words for `dr-explain`."""
