"""How much the commands say. Kept apart from the console, which takes longer to load."""

quiet = False
"""Whether only results, warnings and failures are printed: no words on what happens."""
