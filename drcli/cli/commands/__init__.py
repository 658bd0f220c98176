"""The commands: parse, call, show. They import what only a run needs in their functions."""
