"""Explains words: hyperparameters, settings, terms, parameters, trace columns, codes and errors."""
