"""Runs `python scripts/bench reference_models`, from any folder."""

from bench.__main__ import run

run("reference_models")
