"""Keys of races in the bucket.

A submission is a copy of its model, which later changes do not affect.
"""

import re


def folder(race: str = "") -> str:
    return f"races/{race}/" if race else "races/"


def rules(race: str) -> str:
    return folder(race) + "race.json"


def race_of(key: str) -> str | None:
    found = re.fullmatch(r"races/([a-z0-9-]+)/race\.json", key)
    return found[1] if found else None


def submission(race: str, submission: str) -> str:
    return f"{folder(race)}submissions/{submission}.json"


def order(race: str, submission: str) -> str:
    return f"{folder(race)}order/{submission}.json"


def result(race: str, name: str) -> str:
    return f"{folder(race)}results/{name}.json"


def draw(race: str) -> str:
    return folder(race) + "draw.json"


def lease(race: str) -> str:
    return folder(race) + "lease.json"


def video(race: str, name: str) -> str:
    return f"{folder(race)}videos/{name}.mp4"


def models(race: str, submission: str) -> str:
    return f"{folder(race)}models/{submission}/"


def model(race: str, submission: str, prefix: str) -> str:
    return models(race, submission) + prefix


def submitted_model(prefix: str) -> str:
    return re.sub(r"\Araces/[^/]+/models/[^/]+/", "", prefix)
