"""Keys of races at home in the bucket.

A submission is a copy of its model, so that what happens to the model later does not change the
race.
"""

import re


def folder(race: str = "") -> str:
    """Folder with everything of a race, or of all races."""
    return f"races/{race}/" if race else "races/"


def rules(race: str) -> str:
    """The rules of a race."""
    return folder(race) + "race.json"


def race_of(key: str) -> str | None:
    """The race whose rules this is; None for other keys."""
    found = re.fullmatch(r"races/([a-z0-9-]+)/race\.json", key)
    return found[1] if found else None


def submission(race: str, submission: str) -> str:
    """A submission; sorted by key, they are in the order in which they came."""
    return f"{folder(race)}submissions/{submission}.json"


def order(race: str, submission: str) -> str:
    """Where the organiser has put a submission."""
    return f"{folder(race)}order/{submission}.json"


def result(race: str, name: str) -> str:
    """What a submission or a pair has driven."""
    return f"{folder(race)}results/{name}.json"


def draw(race: str) -> str:
    """The draw of a bracket."""
    return folder(race) + "draw.json"


def lease(race: str) -> str:
    """Says which process drives the queue of a race."""
    return folder(race) + "lease.json"


def video(race: str, name: str) -> str:
    """The video of a submission, or of one car of a pair."""
    return f"{folder(race)}videos/{name}.mp4"


def models(race: str, submission: str) -> str:
    """Folder of the copy of a submitted model."""
    return f"{folder(race)}models/{submission}/"


def model(race: str, submission: str, prefix: str) -> str:
    """Prefix of the copy of a submitted model."""
    return models(race, submission) + prefix


def submitted_model(prefix: str) -> str:
    """The model that a prefix in a race is a copy of; any other prefix itself."""
    return re.sub(r"\Araces/[^/]+/models/[^/]+/", "", prefix)
