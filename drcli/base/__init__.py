"""Errors, files, locks and logs for all packages; nothing about DeepRacer."""
