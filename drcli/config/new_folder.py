"""Plans a working folder, or an experiment in one, in which a training can start at once."""

import re
import shlex
import sys
import sysconfig
from collections.abc import Iterable, Mapping
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.base.problems import Place, ProblemsError, shown
from drcli.config.editing import with_any_value
from drcli.config.example_files import activate_script, model_file, settings_file
from drcli.config.loading import load_settings
from drcli.config.setting_problems import setting_problem
from drcli.config.settings import Settings
from drcli.config.settings_files import EXPERIMENT, content_of, parse_env
from drcli.config.value_types import FOLDER_NAME
from drcli.config.worlds import ROUTE_FILES, built_in, is_installed, own
from drcli.config.write_folder import FolderPlan, NewFile

CUSTOM_FILES = ("reward_function.py", "hyperparameters.json", "model_metadata.json")

EXAMPLES = {"OBJECT_AVOIDANCE": "rewards/object_avoidance/", "HEAD_TO_BOT": "rewards/head_to_bot/"}
"""Where the shipped files of a race lie; those of any other race lie on top."""

IGNORED = "/data/"
"""What git shall leave out: bucket, logs and notes of runs."""

_FIRST_LINE = (
    "# Source this in bash or zsh: source bin/activate.sh [-e EXPERIMENT] [FILE]. Written by "
    "`dr init`.\n"
)
_ACTIVATE = """\
_DR_HOME=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE:-$0}")/.." && pwd) \
_DR_PROGRAMS=%s && . %s "$@"
"""


def plan_folder(folder: Path, values: Mapping[str, str]) -> FolderPlan:
    """Work out a working folder; nothing is written yet.

    Args:
        folder: Where it shall be; it need not exist.
        values: Texts of settings by DR_ name, as far as they are not to be as shipped.

    Raises:
        ProblemsError: A value is wrong.
    """
    folder = folder.absolute()
    system = settings_file("system.env").read_bytes()
    run = settings_file("run.env").read_bytes()
    in_system = _names_in(settings_file("system.env"))
    system = _filled(system, {k: v for k, v in values.items() if k in in_system}, "system.env")
    run = _filled(run, {k: v for k, v in values.items() if k not in in_system}, "run.env")
    settings = load_settings(folder, environ={}, contents={"system.env": system, "run.env": run})
    files = [
        NewFile("run.env", run),
        NewFile("system.env", system),
        *_custom_files("custom_files", values.get("DR_RACE_TYPE", "")),
        NewFile("bin/activate.sh", _activate().encode()),
        NewFile(".gitignore", _gitignore(folder / ".gitignore")),
    ]
    return FolderPlan(folder, tuple(files), ("tracks",), *_missing_track(settings))


def plan_experiment(folder: Path, name: str, values: Mapping[str, str]) -> FolderPlan:
    """Work out experiments/<name>/, beginning with what the working folder has now.

    The experiment gets a model of its own and a free DR_RUN_ID, so that it can run beside the
    others.

    Args:
        folder: A working folder.
        name: Name of the experiment.
        values: Texts of settings by DR_ name, which differ from those of the working folder.

    Raises:
        ProblemsError: A value is wrong, or belongs into system.env, which experiments share.
        SettingsError: The folder is no working folder.
    """
    folder = folder.absolute()
    _refuse_name(name)
    if not (folder / "run.env").is_file():
        raise SettingsError(
            f"run.env: there is no such file in {folder}, so no experiment can begin with it.",
            remedy="Write the working folder first, with `dr init`.",
        )
    shared = [key for key in values if key in _names_in(settings_file("system.env"))]
    if shared:
        found = [
            setting_problem(
                key,
                Place("system.env"),
                f"{key}={shown(values[key])} belongs in system.env, which all experiments share.",
                f"Leave it out, or change it for all: `dr config set {key}={values[key]}`.",
            )
            for key in shared
        ]
        raise ProblemsError(found)
    here = f"experiments/{name}"
    wanted = {
        "DR_RUN_ID": str(_free_run_id(folder)),
        "DR_LOCAL_S3_MODEL_PREFIX": name,
        "DR_LOCAL_S3_CUSTOM_FILES_PREFIX": f"custom_files/{name}",
        **values,
    }
    run = _filled(content_of(folder / "run.env", "run.env"), wanted, "run.env")
    # Another experiment, which system.env may choose, is not what is looked at.
    settings = load_settings(folder, environ={}, flags={EXPERIMENT: ""}, contents={"run.env": run})
    mine = [
        NewFile(f"{here}/custom_files/{file}", content_of(folder / "custom_files" / file, file))
        for file in CUSTOM_FILES
        if (folder / "custom_files" / file).is_file() and "DR_RACE_TYPE" not in values
    ]
    custom = mine or _custom_files(f"{here}/custom_files", values.get("DR_RACE_TYPE", ""))
    workers = [
        NewFile(f"{here}/{path.name}", content_of(path, path.name))
        for path in sorted(folder.glob("worker-*.env"))
    ]
    files = (NewFile(f"{here}/run.env", run), *workers, *custom)
    return FolderPlan(folder, files, (), *_missing_track(settings))


def has_activate_script(folder: Path) -> bool:
    """Whether bin/activate.sh of a working folder is ours; the reference has its own."""
    path = folder / "bin" / "activate.sh"
    return path.is_file() and content_of(path, path.name).startswith(_FIRST_LINE.encode())


def _names_in(file: Path) -> set[str]:
    """Names of a shipped settings file, also those that wait behind a # for a value."""
    return {entry.name for entry in parse_env(_uncommented(file.read_bytes()), file.name).entries}


def _filled(data: bytes, values: Mapping[str, str], name: str) -> bytes:
    """A settings file with values; a line that waits behind a # for its value loses that.

    Raises:
        ProblemsError: A value cannot be written there.
        SettingsError: The file is no text.
    """
    there = {entry.name for entry in parse_env(data, name).entries}
    lines = data.splitlines(keepends=True)
    for index, line in enumerate(lines):
        bare = _uncommented(line)
        key = bare.partition(b"=")[0].decode()
        if bare != line and key in values and key not in there:
            lines[index] = bare
    filled = b"".join(lines)
    for key, value in values.items():
        changed = with_any_value(filled, key, value, name)
        if changed is None:
            what = f"{key}={shown(value)} cannot be written into a settings file."
            remedy = "Leave out line breaks, quotes, $ and \\."
            raise ProblemsError([setting_problem(key, Place(name), what, remedy)])
        filled = changed
    return filled


def _uncommented(data: bytes) -> bytes:
    return re.sub(rb"(?m)^# ?(DR_[A-Z0-9_]+=)", rb"\1", data)


def _refuse_name(experiment: str) -> None:
    """Refuse what cannot be a folder in experiments/.

    Raises:
        ProblemsError: It cannot.
    """
    if not FOLDER_NAME.fullmatch(experiment):
        what = f"{EXPERIMENT}={shown(experiment)} is not a plain folder name."
        remedy = "Use letters, digits and the characters . _ -"
        place = Place(f"experiments/{shown(experiment)}")
        raise ProblemsError([setting_problem(EXPERIMENT, place, what, remedy)])


def _custom_files(folder: str, race_type: str) -> list[NewFile]:
    examples = EXAMPLES.get(race_type.upper(), "")
    return [
        NewFile(f"{folder}/{name}", model_file(f"{examples}{name}").read_bytes())
        for name in CUSTOM_FILES
    ]


def _activate() -> str:
    beside = Path(sys.executable).parent
    programs = beside if (beside / "dr").exists() else Path(sysconfig.get_path("scripts"))
    return _FIRST_LINE + _ACTIVATE % (
        shlex.quote(str(programs)),
        shlex.quote(str(activate_script())),
    )


def _gitignore(path: Path) -> bytes:
    """The racer's own lines, if there are any, and ours."""
    before = content_of(path, path.name) if path.is_file() else b""
    if IGNORED.encode() in before.splitlines():
        return before
    gap = b"\n" if before and not before.endswith(b"\n") else b""
    return before + gap + IGNORED.encode() + b"\n"


def _missing_track(settings: Settings) -> tuple[str | None, tuple[str, ...]]:
    """The track where it is still to be fetched, and a sentence about that."""
    world = settings.world_name
    if is_installed(settings.race) or world.endswith(ROUTE_FILES):
        return None, ()
    known = sorted({*built_in(), *own(settings.tracks_folder)})
    warning = (
        f"There is no track {world} here yet; fetch it with `dr-tracks fetch {world}`, or choose "
        f"one of {', '.join(known)}."
    )
    return world, (warning,)


def _free_run_id(folder: Path) -> int:
    """The first number that no run.env of this folder uses."""
    files: Iterable[Path] = (folder / "run.env", *folder.glob("experiments/*/run.env"))
    used = set()
    for file in files:
        name = str(file.relative_to(folder))
        entries = parse_env(content_of(file, name), name).entries
        numbers = [entry.value.strip() for entry in entries if entry.name == "DR_RUN_ID"]
        used.add(numbers[-1] if numbers and numbers[-1] else "0")
    return next(number for number in range(len(used) + 1) if str(number) not in used)
