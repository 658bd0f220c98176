"""The command line: the programs, their commands, what they print and ask."""
