"""The web page of the physical car."""
