"""The settings by subject, each declared once."""
