"""Forms in which policies leave and arrive."""
