"""The settings of a race, from its rules."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from drcli.base.errors import BadValue, Place, ProblemsError
from drcli.base.installation import lazy_imports
from drcli.config.fields import setting_problem
from drcli.config.race_types import RACE_TYPES, RaceKind
from drcli.config.settings import Settings, catalogue
from drcli.config.track_names import track_problem
from drcli.config.value_types import parse_checkpoint
from drcli.model import keys, race_keys
from drcli.races.race_records import RaceRules
from drcli.races.stored_race import StoredRace

with lazy_imports():
    from drcli.drive import build_race

_ALWAYS = (
    "DR_SIM_",
    "DR_CAR_STEERING_",
    "DR_CAR_MAX_SPEED",
    "DR_CAR_BATTERY",
    "DR_ENABLE_DOMAIN_RANDOMIZATION",
    "DR_RANDOMIZE_TEXTURES",
    "DR_EVAL_MAX_RESETS",
    "DR_EVAL_MAX_LAP_SECONDS",
    "DR_EVAL_MAX_MINUTES",
    "DR_EVAL_START_",
    "DR_EVAL_RESET_BEHIND_DIST",
)


def frozen_settings(settings: Settings, race_type: RaceKind) -> dict[str, str]:
    """Settings of the laps, for the rules; later changes do not matter."""
    race = RACE_TYPES[race_type]
    names = (*_ALWAYS, race.settings) if race.settings else _ALWAYS
    return {
        name: setting.text(getattr(settings, setting.field))
        for name, setting in catalogue().items()
        if name.startswith(names) and not (not race.trainable and "_START_" in name)
    }


def shown_settings(rules: RaceRules) -> dict[str, str]:
    known = catalogue()
    return {
        name: text
        for name, text in sorted(rules.settings.items())
        if name not in known or text != known[name].default_text
    }


def settings_of_rules(settings: Settings, rules: RaceRules) -> Settings:
    """This machine's settings with a race's.

    Raises:
        ProblemsError: A setting or value is unknown to this version.
    """
    changes: dict[str, Any] = {
        "world_name": rules.world,
        "race_type": rules.race_type,
        "eval_reverse_direction": rules.reverse,
        "eval_number_of_trials": rules.max_laps,
        "eval_is_continuous": True,
        "eval_off_track_penalty": rules.off_track_penalty_s,
        "eval_collision_penalty": rules.collision_penalty_s,
        "eval_average_laps": rules.average_laps,
        "eval_debug_reward": False,
        "eval_start_offset": catalogue()["DR_EVAL_START_OFFSET"].default,
        "eval_max_minutes": catalogue()["DR_EVAL_MAX_MINUTES"].default,
    }
    place, sources, problems = Place("race"), dict(settings.sources), []
    for name, text in rules.settings.items():
        try:
            setting = catalogue()[name]
            changes[setting.field] = setting.read(text)
        except (KeyError, BadValue) as error:
            unknown = isinstance(error, KeyError)
            what = f"{name}={text} {'is unknown in this version' if unknown else error}."
            problems.append(setting_problem(name, place, what, "Update drcli on this machine."))
        sources[name] = place
    if problems:
        raise ProblemsError(problems)
    sources["DR_WORLD_NAME"] = place
    return settings.replaced(**changes, sources=sources)


def check_track(settings: Settings) -> None:
    """Raises ProblemsError without the track, or room for objects."""
    problem = track_problem(settings.race)
    if problem is not None:  # also one that could be fetched: a race needs it now
        raise ProblemsError([replace(problem, severity="error")])
    if RACE_TYPES[settings.race_type].settings:
        build_race.load_race(settings.race, build_race.load_world(settings.race))


def settings_of_run(settings: Settings, stored: StoredRace, run: Iterable[str]) -> Settings:
    changes: dict[str, Any] = {"eval_save_mp4": False}
    for name, prefixes in zip(run, (_OWN, _OPPONENT), strict=False):
        submission = stored.submissions[name]
        model = race_keys.model(stored.race, name, submission.model)
        number = str(parse_checkpoint(submission.checkpoint))
        values = (model, keys.metrics_prefix(model), number, submission.racer)
        changes |= dict(zip(prefixes, values, strict=True))
    if "eval_opp_s3_model_prefix" in changes:
        changes["eval_opp_model_prefix"] = changes["eval_opp_s3_model_prefix"]
    return settings.replaced(**changes)


_OWN = ("model_prefix", "metrics_prefix", "eval_checkpoint", "racer_name")
_OPPONENT = (
    "eval_opp_s3_model_prefix",
    "eval_opp_s3_metrics_prefix",
    "eval_opp_checkpoint",
    "eval_opp_racer_name",
)
