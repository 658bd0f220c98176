"""Runs `python scripts/docs`, under the name that it had in version 0.1.0."""

import runpy
from pathlib import Path

runpy.run_path(str(Path(__file__).parent / "docs"), run_name="__main__")
