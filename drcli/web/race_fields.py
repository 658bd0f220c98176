"""The form of a race: its fields, and sentences of `dr-race` in their words."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import Any, Literal

from drcli.base.errors import Problem, ProblemsError, SettingsError

KINDS = {
    "TIME_TRIAL": "Time trial",
    "OBJECT_AVOIDANCE": "Object avoidance",
    "HEAD_TO_BOT": "Head to bot",
    "HEAD_TO_MODEL": "Head to head, in pairs",
}
RANKINGS = {
    "best-lap": "Best lap",
    "best-average": "Best average of laps in a row",
    "total-time": "Total time of all laps",
}
PAIRINGS = {
    "round-robin": "Round robin: everybody meets everybody once",
    "bracket": "Bracket: the winners go on",
}
ALONE = ("TIME_TRIAL", "OBJECT_AVOIDANCE", "HEAD_TO_BOT")


@dataclass(frozen=True)
class RuleField:
    """A rule in the form.

    Attributes:
        name: In requests.
        option: Of `dr-race create`, if it is not almost the name.
        options: Of a choice, with their words.
        only: Kinds of race that have this rule; empty for all.
        placeholder: What an empty field shows; of a number, "default".
        more: Attributes of the control.
    """

    name: str
    label: str
    part: str
    kind: Literal["text", "choice", "whole", "number", "time", "flag", "many"]
    help: str = ""
    option: str = ""
    options: Mapping[str, str] | None = None
    only: tuple[str, ...] = ()
    placeholder: str = ""
    more: Mapping[str, Any] | None = None


_RACE, _DECIDES, _WHO = "Race", "What decides", "Who and when"
FIELDS = (
    RuleField(
        *("name", "Name", _RACE, "text"),
        "What racers see, such as Friday Cup.",
        more={"required": True},
    ),
    RuleField("world", "Track", _RACE, "choice", option="DR_WORLD_NAME"),
    RuleField("race_type", "Kind of race", _RACE, "choice", option="--type", options=KINDS),
    RuleField(
        *("obstacles", "Obstacles", _RACE, "whole"),
        "Boxes on the track. Empty: as in the settings.",
        option="DR_OA_NUMBER_OF_OBSTACLES",
        only=("OBJECT_AVOIDANCE",),
    ),
    RuleField(
        *("bots", "Bot cars", _RACE, "whole"),
        "Cars that drive at a constant speed. Empty: as in the settings.",
        option="DR_H2B_NUMBER_OF_BOT_CARS",
        only=("HEAD_TO_BOT",),
    ),
    RuleField("reverse", "Opposite direction", _RACE, "flag"),
    RuleField("ranking", "What decides", _DECIDES, "choice", options=RANKINGS, only=ALONE),
    RuleField(
        *("pairing", "Who meets whom", _DECIDES, "choice"),
        options=PAIRINGS,
        only=("HEAD_TO_MODEL",),
    ),
    RuleField(
        *("max_laps", "Laps", _DECIDES, "whole"),
        "Each submission drives this many, one after the other.",
        option="--laps",
    ),
    RuleField(
        *("min_laps", "Complete laps needed", _DECIDES, "whole"),
        "A submission with fewer complete laps is not ranked. Empty: 1 for the best lap, all for "
        "the total time.",
        only=ALONE,
    ),
    RuleField(
        *("average_laps", "Laps in the best average", _DECIDES, "whole"),
        "Complete laps in a row. Empty: 3, or all if there are fewer.",
        only=ALONE,
    ),
    RuleField("off_track_penalty_s", "Penalty for leaving the track, seconds", _DECIDES, "number"),
    RuleField("collision_penalty_s", "Penalty for a collision, seconds", _DECIDES, "number"),
    RuleField(
        *("max_submissions", "Submissions of each racer", _WHO, "whole"),
        "0 for any number. Empty: 1 in pairs, else any number.",
    ),
    RuleField("opens", "Opens", _WHO, "time", "Empty: at once."),
    RuleField("closes", "Closes", _WHO, "time", "Empty: stays open until somebody closes it."),
    RuleField(
        *("seed", "Seed", _WHO, "whole"),
        "All submissions drive with this seed. Empty: a random one.",
        placeholder="random",
    ),
    RuleField("sensors", "Allowed sensors (none chosen: any)", _WHO, "many", option="--sensor"),
)

_NUMBERS = ("whole", "number")
_LABELS = {
    each.option or f"--{each.name.removesuffix('_s').replace('_', '-')}": each for each in FIELDS
} | {f"--{each.name}": each for each in FIELDS if each.name in ("obstacles", "bots", "world")}
_LABELS["--checkpoint"] = RuleField("checkpoint", "Checkpoint", _WHO, "choice")
_OPTION = re.compile(r"--[a-z]+(?:-[a-z]+)*|\bDR_[A-Z0-9_]+")
_SAID = {
    "name of the race": "name",
    "name of the racer|has submitted": "racer",
    "^Checkpoint ": "checkpoint",
    "s3:|prefix of a model": "prefix",
}
"""Sentences that name no option, and the field that they are about."""


def of_a_field(error: SettingsError) -> ProblemsError:
    """In the words of the form, with the field that it is about, if any."""

    def words(found: re.Match[str]) -> str:
        return f"“{_LABELS[found[0]].label}”" if found[0] in _LABELS else found[0]

    message, remedy = str(error), error.remedy
    said = (key for pattern, key in _SAID.items() if re.search(pattern, message))
    named = (
        _LABELS[option].name
        for option in _OPTION.findall(f"{message} {remedy}")
        if option in _LABELS
    )
    key = next(said, None) or next(named, "")
    message, remedy = (_OPTION.sub(words, text) for text in (message, remedy))
    return ProblemsError([Problem("", "error", "", None, message, remedy, key)])


def of_a_form(function: Callable[..., Any]) -> Callable[..., Any]:
    """Says what a function refuses in the words of the form."""

    @wraps(function)
    def call(*given: Any) -> Any:
        try:
            return function(*given)
        except SettingsError as error:
            said = of_a_field(error)
            if isinstance(error, ProblemsError) and not said.problems[0].key:
                raise  # of the settings, which has its own place
            raise said from None

    return call


def form_of(values: Mapping[str, Any], more: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The fields with their present values; `more` has what else a field has by its name."""
    return [
        {
            **vars(each),
            "options": list((each.options or {}).items()),
            "placeholder": each.placeholder or ("default" if each.kind in _NUMBERS else ""),
            "only": ("race_type", each.only) if each.only else None,
            "value": values.get(each.name),
            **more.get(each.name, {}),
        }
        for each in FIELDS
    ]
