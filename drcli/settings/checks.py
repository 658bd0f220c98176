"""Judges values: whether they fit their field and fit each other."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic import ValidationError

from drcli.findings import Finding, UnfitError, one_of
from drcli.settings.fields import Setting
from drcli.settings.model import Settings, catalogue


def misfits(values: Mapping[str, str], texts: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    """DR_ name, reason and remedy of each value that its field refuses."""
    for name, text in texts.items():
        if not all(character >= " " for character in text):
            yield name, "holds a line break or control character", f"Remove it from {name}."
    try:
        Settings.model_validate(
            {**values, "directory": Path(), "extra": {}, "sources": {}, "warnings": ()}
        )
    except ValidationError as e:
        by_field = {setting.field: setting for setting in catalogue().values()}
        for error in e.errors(include_url=False):
            setting = by_field[str(error["loc"][0])]
            cause = error.get("ctx", {}).get("error")
            if isinstance(cause, UnfitError):
                yield setting.name, cause.reason, cause.remedy
            else:
                yield setting.name, *_explain(setting, error["type"], texts[setting.name])


def contradictions(settings: Settings) -> Iterator[Finding]:
    """Values that fit on their own but not together."""
    if settings.cloud in ("remote", "azure") and not settings.remote_minio_url:
        yield Finding(
            settings.source("DR_CLOUD"),
            f"DR_CLOUD={settings.cloud} needs an address, but DR_REMOTE_MINIO_URL is empty",
            "Set DR_REMOTE_MINIO_URL, as in http://192.168.1.5:9000, or write DR_CLOUD=local.",
        )
    if settings.h2b_lower_lane_change_time > settings.h2b_upper_lane_change_time:
        yield Finding(
            settings.sources.get("DR_H2B_LOWER_LANE_CHANGE_TIME")
            or settings.source("DR_H2B_UPPER_LANE_CHANGE_TIME"),
            f"DR_H2B_LOWER_LANE_CHANGE_TIME={settings.h2b_lower_lane_change_time} is more than "
            f"DR_H2B_UPPER_LANE_CHANGE_TIME={settings.h2b_upper_lane_change_time}",
            "Exchange the two, or set both to the same time.",
        )
    if settings.pretrained and settings.pretrained_prefix == settings.model_prefix:
        yield Finding(
            settings.source("DR_LOCAL_S3_PRETRAINED_PREFIX"),
            f"DR_LOCAL_S3_PRETRAINED_PREFIX={settings.pretrained_prefix} is the model to train",
            f"Give DR_LOCAL_S3_MODEL_PREFIX a new name, such as {settings.model_prefix}-clone.",
        )


def _explain(setting: Setting, kind: str, text: str) -> tuple[str, str]:
    """Reason and remedy for one of pydantic's own refusals."""
    remedy = f"Set {setting.name} to {setting.expected}"
    if setting.default_text:
        remedy += f", or leave it out for the default {setting.default_text}"
    if kind == "literal_error":
        return f"is none of {', '.join(setting.choices)}", one_of(setting.choices, text)
    if kind.startswith(("greater_than", "less_than")):
        edge = "below" if kind.startswith("greater_than") else "above"
        limit = setting.low if edge == "below" else setting.high
        return f"is {edge} {limit}", f"{remedy}."
    reasons = {
        "flag": "is neither True nor False",
        "whole": "is no whole number",
        "number": "is no number",
    }
    return reasons.get(setting.kind, "is no readable text"), f"{remedy}."
