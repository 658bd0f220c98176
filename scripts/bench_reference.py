"""Runs `python scripts/bench reference`, under the name that it had in version 0.1.0."""

from bench.__main__ import run

run("reference")
