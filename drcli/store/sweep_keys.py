"""Keys of sweeps in the bucket."""

import re

FOLDER = "sweeps/"
"""Folder with the records of all sweeps; their models are where all models are."""


def sweep(name: str) -> str:
    """The record of a sweep."""
    return f"{FOLDER}{name}.json"


def of_tune(name: str) -> str:
    """The folder of what Ray Tune writes while the sweep runs."""
    return f"{FOLDER}{name}/"


def sweep_of(key: str) -> str | None:
    """The sweep whose record this is; None for other keys."""
    found = re.fullmatch(r"sweeps/([a-z0-9-]+)\.json", key)
    return found[1] if found else None
