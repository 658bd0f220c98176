"""Policies in files of other systems, read and written."""
