"""Problems with settings: which rule a setting belongs to."""

from drcli.base.problems import Place, Problem, Severity

RULES = {
    "DR_WORLD_NAME": "V-05",
    "DR_RACE_TYPE": "V-07",
    "DR_CAR_COLOR": "V-08",
    "DR_LOCAL_S3_PRETRAINED": "V-10",
    "DR_LOCAL_S3_PRETRAINED_PREFIX": "V-10",
    "DR_LOCAL_S3_PRETRAINED_CHECKPOINT": "V-10",
    "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST": "V-42",
    "DR_WORKERS": "V-45",
}
"""Settings with a rule of their own."""

GENERAL_RULE = "V-12"
"""The rule for all other settings, and for the files that they stand in."""


def setting_problem(
    name: str, place: Place, message: str, remedy: str, *, severity: Severity = "error"
) -> Problem:
    """A problem with one setting.

    Args:
        name: The setting.
        place: Where it was given.
        message: Name, value and what is wrong with it, as a sentence.
        remedy: What to do about it.
        severity: How bad it is.
    """
    return Problem(RULES.get(name, GENERAL_RULE), severity, *place, message, remedy, name)


def file_problem(
    place: Place, message: str, remedy: str, *, severity: Severity = "error"
) -> Problem:
    """A problem with a settings file, or with a line that is not a setting."""
    return Problem(GENERAL_RULE, severity, *place, message, remedy)
