"""Finds names that do nothing here: unused, old and misspelt ones."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

from drcli.base.errors import Place, Problem, closest, shown
from drcli.config.fields import file_problem, hidden, setting_problem
from drcli.config.groups.system import DERIVED, DOCKER, WINDOW
from drcli.config.settings import Settings, catalogue
from drcli.config.settings_files import Entry, Layers

TYPO_SIMILARITY = 0.85
"""DR_WORKER and DR_WORKERS: 0.95."""

OUTSIDE = ("default", "environment")
"""Not written by the racer: a shell activated by the reference holds all names."""

REMEDY = "Keep the lines or remove them."

OF_COMMANDS = frozenset({"DR_CAR_PASSWORD", "DR_DROA_PASSWORD", "DR_DEBUG"})
"""Only from the environment: no file should hold them."""

_VIEWER = "the console needs no files of nginx"
_TOURNAMENT = "`dr-race create NAME --type HEAD_TO_MODEL` makes a tournament"
_IMPORT = "models are not imported into the console"
_PROFILE = "keys come from the profile DR_LOCAL_S3_PROFILE"
_CUT_OFF = "the name is cut off; write {}"


@dataclass(frozen=True)
class Former:
    """A former name of the reference; `harmless` None: any value is."""

    meaning: str
    reason: str
    harmless: tuple[str, ...] | None = None

    def missed(self, value: str) -> bool:
        return self.harmless is not None and value.strip().casefold() not in self.harmless


FORMER: Mapping[str, Former] = {
    "DR_COACH_IMAGE": Former("Version of an image.", DOCKER),
    "DR_ROBOMAKER_IMAGE_TYPE": Former("Kind of an image.", DOCKER),
    "DR_GPU_AVAILABLE": Former("Whether containers get the GPU.", DOCKER),
    "DR_DOCKER_FILE_SEP": Former("Word between files of containers.", DOCKER),
    "DR_DOCKER_MAJOR_VERSION": Former("Version of docker.", DOCKER),
    "DR_COMPOSE_FILE": Former("Files of containers.", DOCKER),
    "DR_COMPOSE_FILES": Former("Files of containers.", DOCKER),
    "DR_TRAIN_COMPOSE_FILE": Former("Files of containers.", DOCKER),
    "DR_EVAL_COMPOSE_FILE": Former("Files of containers.", DOCKER),
    "DR_MINIO_COMPOSE_FILE": Former("Files of containers.", DOCKER),
    "DR_MOUNT_DIR": Former("Folder that a container sees.", DOCKER),
    "DR_ROBOMAKER_PORT": Former("Port of the picture.", DERIVED),
    "DR_LOCAL_ENDPOINT_URL": Former("Address of the bucket.", DERIVED),
    "DR_LOCAL_ACCESS_KEY_ID": Former("Key of the bucket.", _PROFILE),
    "DR_LOCAL_SECRET_ACCESS_KEY": Former("Secret of the bucket.", _PROFILE),
    "DR_UPLOAD_PROFILE": Former("Option of the AWS command.", DERIVED),
    "DR_UPLOAD_S3_ROLE": Former("Role of the console that imports a model.", _IMPORT),
    "DR_UPLOAD_MODEL_NAME": Former("Name of the model in the console.", _IMPORT),
    "DR_USE_GUI": Former("Show the simulator.", WINDOW),
    "DR_NGINX_CONF": Former("Configuration of the viewer.", _VIEWER),
    "DR_VIEWER_HTML": Former("Page of the viewer.", _VIEWER),
    "DR_LOCAL_S3_METRICS_KEY": Former(
        "Object with the metrics.",
        "metrics have the names that analysis tools look for, in DR_LOCAL_S3_METRICS_PREFIX",
    ),
    "DR_LOCAL_S3_TOURNAMENT_JSON_FILE": Former("Participants of a tournament.", _TOURNAMENT),
    "DR_LOCAL_S3_TOURNAMENT_PARAMS_FILE": Former("Description of a tournament.", _TOURNAMENT),
    "DR_NUMBER_OF_EPISODES": Former(
        "Episodes of a training.",
        "DR_TRAIN_MAX_ITERATIONS and term_cond_max_episodes end a training",
        harmless=("", "0"),
    ),
    "DR_TARGET_REWARD_SCORE": Former(
        "Reward that ends a training.",
        "DR_TRAIN_STOP_MEAN_SCORE ends a training by its reward",
        harmless=("", "none"),
    ),
    "DR_EVAL_ENABLE_RESETS": Former(
        "Put a car back that left the track.", "DR_EVAL_MAX_RESETS says how often a car is put back"
    ),
    "DR_OA_PSEUDO_RANDOMIZE_OBSTACLE_LOCATIONS": Former(
        "Draw from a few arrangements of obstacles.",
        "DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS moves them in each episode, DR_OA_OBJECT_POSITIONS "
        "fixes them",
        harmless=("", "false"),
    ),
    "DR_OA_NUMBER_OF_PSEUDO_RANDOM_PLACEMENTS": Former(
        "How many arrangements.", "obstacles are not drawn from a few arrangements"
    ),
    # These two are in a script of the reference, cut off like this.
    "DR_TRAIN_ALTERNATE_DRIVI": Former(
        "Turn round after every training episode.",
        _CUT_OFF.format("DR_TRAIN_ALTERNATE_DRIVING_DIRECTION"),
        harmless=("", "false"),
    ),
    "DR_TRAIN_ROUND_ROBIN_ADVANC": Former(
        "Distance from one start to the next.",
        _CUT_OFF.format("DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST"),
        harmless=("", "0.05"),
    ),
}


def old_names() -> dict[str, str]:
    return {old: setting.name for setting in catalogue().values() for old in setting.old_names}


def rename_old(layers: Sequence[dict[str, Entry]]) -> list[Problem]:
    """Replace old names in the layers, with a warning about each that has an effect."""
    warnings = []
    for old, name in old_names().items():
        layer = next((layer for layer in layers if old in layer), None)
        if layer is None:
            continue
        idle = catalogue()[name].effect != "used"  # one line tells of all without effect
        what = f"{old} is the old name of {name}"
        if any(name in other for other in layers):
            what, remedy = f"{what} and is ignored, because both are set.", "Remove the line."
        else:
            layer[name] = replace(layer[old], name=name)
            what, remedy = f"{what}; write the new name.", "Correct the name."
        place = layer[old].place
        if not idle:
            warnings.append(setting_problem(name, place, what, remedy, severity="warning"))
    return warnings


def unknown_names(
    looked_up: Layers, layers: Sequence[dict[str, Entry]]
) -> tuple[dict[str, str], list[Problem]]:
    """Names that are not settings with their values, and problems with them."""
    values: dict[str, str] = {}
    problems: list[Problem] = []
    known = catalogue().keys() | old_names().keys()
    from_outside: list[str] = []
    for layer in layers:
        for name, entry in layer.items():
            ours = name.upper().startswith("DR_")
            outside = entry.place.file == "environment"
            if name in known or name in values:
                continue
            if outside and (not ours or name in FORMER or name in OF_COMMANDS):
                continue
            meant = _meant(name)
            if ours and meant is not None and not outside:
                what = f"{name}={shown(hidden(name, entry.value))} is not a setting."
                remedy = f"Did you mean {meant}? Correct the name, or remove the line."
                problems.append(setting_problem(name, entry.place, what, remedy))
                continue
            text = looked_up.text(name)
            if text is None or name in looked_up.problems:
                text = entry.value
            values[name] = text
            if name in looked_up.referenced or name in FORMER:
                continue
            if outside:
                from_outside.append(name if meant is None else f"{name} (did you mean {meant}?)")
            else:
                hint = f" Did you mean {meant}?" if meant is not None else ""
                what = f"{shown(name)} is not a setting and has no effect.{hint}"
                remedy = "Correct the line, or remove it."
                problem = setting_problem(name, entry.place, what, remedy, severity="warning")
                problems.append(problem)
    if from_outside:
        # A shell in which the reference was activated has a dozen names of its own.
        what = f"unknown names without effect: {', '.join(from_outside)}."
        place, remedy = Place("environment"), "Correct them, or ignore this."
        problems.append(file_problem(place, what, remedy, severity="warning"))
    return values, problems


def _meant(name: str) -> str | None:
    if name in FORMER:
        return None
    ours = name.upper().startswith("DR_")
    return closest(name if ours else f"DR_{name}", catalogue(), TYPO_SIMILARITY)


@dataclass(frozen=True)
class WithoutEffect:
    """Settings that do nothing, all for the same reason."""

    reason: Annotated[str, "Why, without a full stop."]
    names: Annotated[tuple[str, ...], "The settings, in the order of the documentation."]


def without_effect(settings: Settings) -> tuple[WithoutEffect, ...]:
    """Every name in the racer's files that does nothing."""
    by_reason: dict[str, list[str]] = {}
    for item in _unused(settings):
        if settings.place(item.name).file not in OUTSIDE:
            by_reason.setdefault(item.reason, []).append(item.name)
    return tuple(WithoutEffect(reason, tuple(names)) for reason, names in by_reason.items())


def effect_warnings(settings: Settings) -> Iterator[Problem]:
    """One per reason, of those that a racer may count on."""
    by_reason: dict[str, list[_Unused]] = {}
    for item in _unused(settings):
        if item.missed:
            by_reason.setdefault(item.reason, []).append(item)
    for reason, group in by_reason.items():
        name = group[0].name
        written = ", ".join(f"{item.name}={shown(hidden(item.name, item.value))}" for item in group)
        what = f"{written} {'has' if len(group) == 1 else 'have'} no effect: {reason}."
        yield setting_problem(name, settings.place(name), what, REMEDY, severity="warning")


def harmless_summary(settings: Settings) -> Problem | None:
    """One warning about all others, which only checks tell."""
    missed = {item.name for item in _unused(settings) if item.missed}
    names = [
        name for group in without_effect(settings) for name in group.names if name not in missed
    ]
    if not names:
        return None
    place = Place(" and ".join(sorted({settings.place(name).file for name in names})))
    what = (
        f"{len(names)} of the settings {'is' if len(names) == 1 else 'are'} for containers, "
        "windows, videos and the like, without effect here. `dr config check` names them."
    )
    return file_problem(place, what, REMEDY, severity="warning")


@dataclass(frozen=True)
class _Unused:
    name: str
    value: str
    reason: str
    missed: bool


def _unused(settings: Settings) -> Iterator[_Unused]:
    for name, setting in catalogue().items():
        if setting.effect != "used":
            value = getattr(settings, setting.field)
            off = value == setting.default or str(value).casefold() in ("false", "none")
            missed = setting.effect == "planned" and not off
            yield _Unused(name, str(value), setting.reason, missed)
    for name, value in settings.extra.items():
        if name in FORMER:
            former = FORMER[name]
            yield _Unused(name, value, former.reason, former.missed(value))
