"""Tries reward functions on a drive of scripted drivers: checks, pictures and comparisons."""
