"""The commands. `dr NAME --help` loads what is imported here, but not in `lazy_imports()`."""
