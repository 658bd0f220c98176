"""Keys of sweeps in the bucket."""

import re

FOLDER = "sweeps/"


def sweep(name: str) -> str:
    return f"{FOLDER}{name}.json"


def of_tune(name: str) -> str:
    return f"{FOLDER}{name}/"


def sweep_of(key: str) -> str | None:
    found = re.fullmatch(r"sweeps/([a-z0-9-]+)\.json", key)
    return found[1] if found else None
