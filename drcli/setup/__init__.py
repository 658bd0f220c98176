"""Sets up: writes working folders, activates them, completes command lines."""
