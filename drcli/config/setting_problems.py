"""Problems with settings: broken rules, and which values may be shown."""

import re
from urllib.parse import urlsplit

from drcli.base.problems import Place, Problem, Severity

RULES = {
    "DR_WORLD_NAME": "V-05",
    "DR_RACE_TYPE": "V-07",
    "DR_CAR_COLOR": "V-08",
    "DR_TRAIN_EVAL_WORLD": "V-05",
    "DR_CURRICULUM_FILE": "V-60",
    "DR_LOCAL_S3_PRETRAINED": "V-10",
    "DR_LOCAL_S3_PRETRAINED_PREFIX": "V-10",
    "DR_LOCAL_S3_PRETRAINED_CHECKPOINT": "V-10",
    "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST": "V-42",
    "DR_WORKERS": "V-45",
}
GENERAL_RULE = "V-12"
HIDDEN = "(hidden)"

_SECRET = re.compile(
    r"SECRET|PASSWORD|PASSWD|TOKEN|CREDENTIAL|ACCESS_?KEY|API_?KEY|WEBHOOK", re.IGNORECASE
)
"""Whoever knows the address of a webhook may write there."""


def setting_problem(
    name: str, place: Place, message: str, remedy: str, *, severity: Severity = "error"
) -> Problem:
    """A problem with one setting; the message has its name and value."""
    return Problem(RULES.get(name, GENERAL_RULE), severity, *place, message, remedy, name)


def file_problem(
    place: Place, message: str, remedy: str, *, severity: Severity = "error"
) -> Problem:
    """A problem with a file, or a line that is not a setting."""
    return Problem(GENERAL_RULE, severity, *place, message, remedy)


def hidden(name: str, value: str) -> str:
    """A value without a secret, password or signature."""
    if _SECRET.search(name):
        return HIDDEN if value else ""
    if "://" not in value:
        return value
    try:
        address = urlsplit(value)
    except ValueError:
        return HIDDEN
    _, at, host = address.netloc.rpartition("@")
    shown = address._replace(
        netloc=f"{HIDDEN}@{host}" if at else host, query=HIDDEN if address.query else ""
    )
    return value if shown == address else shown.geturl()
