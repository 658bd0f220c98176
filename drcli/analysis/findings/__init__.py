"""Findings from the tables of a training: verdict, and advice with evidence."""
