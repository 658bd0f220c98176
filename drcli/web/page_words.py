"""Sentences of the terminal in the words of the page: its buttons and pages instead of commands.

A command without a counterpart in the page stays, with the remark that it is for a terminal.
"""

import re
from typing import Any

SENTENCES = ("message", "remedy", "warnings", "advice", "damaged", "watches", "notes")
"""Keys of answers whose texts are sentences about what happened."""

COMMANDS = {
    "dr console": "",
    "dr config": "the page “Settings”",
    "dr docs settings": "the page “Settings”",
    "dr init": "the page “New training”",
    "dr-car list": "the page “Car”",
    "dr-car login": "“Log in” on the page “Car”",
    "dr-car status": "the page “Car”",
    "dr-analyze": "“Analyse” on the page of the model",
    "dr-delete-model": "“Delete” on the page of the model",
    "dr-doctor": "“Validate now” on the page “New training”",
    "dr-evaluate": "“Evaluate” on the page of the model",
    "dr-explain": "the help at each field",
    "dr-export car": "“Download” on the page of the model",
    "dr-export onnx": "“Download” on the page of the model",
    "dr-history": "the page “Models”",
    "dr-import": "“Import a model” on the page “Models”",
    "dr-increment-training": "“Clone” on the page of the model",
    "dr-init": "the page “New training”",
    "dr-list-checkpoints": "the tab “Checkpoints” of the model",
    "dr-list-models": "the page “Models”",
    "dr-logs": "the log on the page “Live”",
    "dr-note": "the notes of the model",
    "dr-race close": "“Close for submissions”",
    "dr-race create": "“Make a race”",
    "dr-race delete": "“Delete”",
    "dr-race list": "the page “Races”",
    "dr-race move": "the arrows beside it",
    "dr-race open": "“Open again”",
    "dr-race restart": "“Drive again”",
    "dr-race rules": "“Change the rules”",
    "dr-race run": "“Drive the queue”",
    "dr-race show": "the page of the race",
    "dr-race stop": "“Stop the queue”",
    "dr-race submit": "“Submit a model”",
    "dr-race withdraw": "“Withdraw”",
    "dr-reward check": "the check beside the reward function",
    "dr-spot create": "“Start a spot training” on the page “Spot”",
    "dr-spot create-base": "“Make a bucket” on the page “Spot”",
    "dr-spot delete": "“Delete” on the page “Spot”",
    "dr-spot list": "the page “Spot”",
    "dr-spot stop": "“Stop and save” on the page “Spot”",
    "dr-start-loganalysis": "“Analyse” on the page of the model",
    "dr-start-training --resume": "“Resume the training” on the page of the model",
    "dr-start-training": "“Start the training” on the page “New training”",
    "dr-status": "the page “Live”",
    "dr-stop-evaluation": "“Stop the evaluation” on the page of the model",
    "dr-stop-training": "“Stop the training” on the page “Live”",
    "dr-tracks fetch": "“Start the training” (which asks first)",
    "dr-tracks list": "the list of tracks on the page “New training”",
    "dr-upload-model": "“Upload” on the page of the model",
    "dr-validate": "“Validate now” on the page “New training”",
}
"""What does the same in the page; empty: it is meant for a terminal."""

_ONLY_THERE = ("--ca", "--distill", "--model", "--new-certificate")
"""Options that the page does not have."""

OPTIONS = {
    "--base": "“Bucket of the model”",
    "--bucket": "DR_LOCAL_S3_BUCKET on the page “Settings”",
    "--now": "“Delete”",
    "--profile or DR_LOCAL_S3_PROFILE": "DR_LOCAL_S3_PROFILE on the page “Settings”",
    "--region": "DR_AWS_APP_REGION on the page “Settings”",
} | {
    option: f"`dr-spot create {option}` in a terminal"
    for option in ("--image", "--max-price", "--processor", "--type")
}
"""Options of `dr-spot` that a sentence names without the command."""

_COMMAND = re.compile(r"`(dr[- ][a-z][^`]*)`(?! in a terminal)")
_OPTION = re.compile(rf"`[^`]*`|(?:{'|'.join(OPTIONS)})(?![-\w])")
_LINE = re.compile(r"(\.env) line \d+")
_LETTER = re.compile(r" with -[a-z]\b|; -[a-z] would [^.;]*")
_AGAIN = re.compile(r"run the command again")


def in_page(text: str) -> str:
    """Without commands, and without lines of settings files, which the page shows as fields."""

    def words(found: re.Match[str]) -> str:
        known = [name for name in COMMANDS if found[1].startswith(name)]
        if not known or any(option in found[1].split() for option in _ONLY_THERE):
            return f"{found[0]} in a terminal"
        place = COMMANDS[max(known, key=len)] or found[0]
        begins = not text[: found.start()].rstrip(" ") or text[: found.start()].endswith(
            (". ", "? ")
        )
        return place[0].upper() + place[1:] if begins else place

    text = _AGAIN.sub("try again", _LETTER.sub("", _LINE.sub(r"\1", text)))
    text = _OPTION.sub(lambda found: OPTIONS.get(found[0], found[0]), text)
    return _COMMAND.sub(words, text)


def for_page(value: Any) -> Any:
    """Plain data with its sentences in the words of the page."""
    if isinstance(value, dict):
        return {
            key: _said(item) if key in SENTENCES else for_page(item) for key, item in value.items()
        }
    return [for_page(item) for item in value] if isinstance(value, list) else value


def _said(value: Any) -> Any:
    if isinstance(value, str):
        return in_page(value)
    return [_said(item) for item in value] if isinstance(value, list) else for_page(value)
