"""Runs `python scripts/bench startup`, under the name that it had in version 0.1.0."""

from bench.__main__ import run

run("startup")
