"""Trainings on spot machines of Amazon."""
