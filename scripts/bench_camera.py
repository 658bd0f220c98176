"""Runs `python scripts/bench camera`, under the name that it had in version 0.1.0."""

from bench.__main__ import run

run("camera")
