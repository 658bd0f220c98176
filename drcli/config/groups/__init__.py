"""The settings by subject, each declared once with type, limits, default and help."""
