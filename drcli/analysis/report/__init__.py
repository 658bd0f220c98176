"""The report of an analysis: one HTML file that any browser shows without a network."""
