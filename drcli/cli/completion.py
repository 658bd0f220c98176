"""Installs completion with the Tab key, for all programs at once.

Typer's own scripts serve one program each, and in bash cannot complete `NAME=value`. These use
its answers for fish: a line `word<Tab>meaning` for each candidate.
"""

import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Literal, get_args

from drcli.base.errors import DrError, SettingsError
from drcli.base.installation import lazy_imports
from drcli.cli.command_table import COMMANDS, program_names
from drcli.cli.working_folder import working_folder
from drcli.config import activation

with lazy_imports():
    from drcli.checks.explain import lookup
    from drcli.config import presets as config_presets
    from drcli.config import settings as config_settings
    from drcli.config import shell_variables, track_names, value_types


Shell = Literal["bash", "zsh", "fish"]
SHELLS: tuple[Shell, ...] = get_args(Shell)

QUESTION, LINE = "_DR_COMPLETE", "_TYPER_COMPLETE_ARGS"
"""Variables of Typer."""

ASKS = {QUESTION: "complete_fish", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}

_ASK = f"env {' '.join(f'{name}={value}' for name, value in ASKS.items())} {LINE}="

_BASH = """\
# Makes the Tab key complete the dr commands in bash. Written by `dr completion`.
_dr_complete() {
    local line=${COMP_LINE:0:COMP_POINT} word start
    start=${line##*[[:space:]]}
    start=${start%"${start##*=}"} # bash completes only what follows a =
    COMPREPLY=()
    while IFS=$'\\t' read -r word _; do
        if [[ -n $word ]]; then COMPREPLY+=("${word#"$start"}"); fi
    done < <({ask}"$line" dr 2>/dev/null)
    if [[ ${#COMPREPLY[@]} == 1 && ${COMPREPLY[0]} == *= ]]; then
        compopt -o nospace
    fi
}
complete -o bashdefault -o default -F _dr_complete {programs}
"""

_ZSH = """\
# Makes the Tab key complete the dr commands in zsh. Written by `dr completion`.
_dr_complete() {
    local line
    local -a words_found names_found
    for line in "${(@f)$({ask}"${words[1,CURRENT]}" dr 2>/dev/null)}"; do
        [[ -n $line ]] || continue
        line=${${line//:/\\\\:}/$'\\t'/:}
        if [[ $line == *= ]]; then names_found+=("$line"); else words_found+=("$line"); fi
    done
    (( $#words_found + $#names_found )) || { _files; return; }
    (( $#words_found )) && _describe dr words_found
    (( $#names_found )) && _describe dr names_found -S ''
}
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit -i; }
compdef _dr_complete {programs}
"""

_FISH = """\
# Makes the Tab key complete the dr commands in fish. Written by `dr completion`.
function __dr_complete
    set -l found ({ask}(commandline -cp | string collect) dr 2>/dev/null)
    if test -n "$found"
        printf '%s\\n' $found
    else
        __fish_complete_path (commandline -ct)
    end
end
for program in {programs}
    complete -c $program -f -a '(__dr_complete)'
end
"""

_TEMPLATES: dict[Shell, str] = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}


def script(shell: Shell) -> str:
    text = _TEMPLATES[shell].replace("{ask}", _ASK)
    return text.replace("{programs}", " ".join(program_names()))


@dataclass(frozen=True)
class Installed:
    """Where completion was installed.

    Attributes:
        shell: bash, zsh or fish.
        script: The file that was written.
        start_file: The shell's start file, which loads the script; None for fish.
        added: Whether a line was added to the start file; it is never added twice.
    """

    shell: Shell
    script: str
    start_file: str | None
    added: bool


def shell_of(environ: Mapping[str, str]) -> Shell:
    """The shell of this user.

    Raises:
        SettingsError: It is not one of these three.
    """
    name = Path(environ.get("SHELL", "")).name
    for shell in SHELLS:
        if name == shell:
            return shell
    raise SettingsError(
        f"SHELL={name or '(nothing)'} is not one of {', '.join(SHELLS)}.",
        remedy="Name the shell, as in `dr completion install bash`.",
    )


def install(shell: Shell, environ: Mapping[str, str]) -> Installed:
    """Write the script and let new shells load it. May be repeated.

    Raises:
        SettingsError: A file cannot be written, or the user has no home.
    """
    by_hand = f"Put what `dr completion show {shell}` prints where your shell reads it."
    try:
        home = Path(environ.get("HOME") or Path.home())
    except RuntimeError:
        raise SettingsError(
            "The home folder of this user is not known, so completion cannot be installed.",
            remedy=f"Set HOME. Or: {by_hand}",
        ) from None
    data = Path(environ.get("XDG_DATA_HOME") or home / ".local" / "share")
    config = Path(environ.get("XDG_CONFIG_HOME") or home / ".config")
    path = data / "drcli" / f"completion.{shell}"
    start_files = {
        "bash": home / ".bashrc",
        "zsh": Path(environ.get("ZDOTDIR") or home) / ".zshrc",
    }
    start_file = start_files.get(shell)
    if start_file is None:  # fish reads every file in this folder
        path = config / "fish" / "conf.d" / "drcli.fish"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(script(shell), "utf-8")
        added = start_file is not None and _add_line(start_file, path)
    except OSError as e:
        raise SettingsError(
            f"{e.filename or path}: cannot be written ({e.strerror or e}).", remedy=by_hand
        ) from e
    return Installed(shell, str(path), None if start_file is None else str(start_file), added)


def _add_line(file: Path, path: Path) -> bool:
    line = f"if [ -r {shlex.quote(str(path))} ]; then . {shlex.quote(str(path))}; fi"
    text = file.read_text("utf-8", "surrogateescape") if file.exists() else ""
    if line in text.splitlines():
        return False
    start = "" if not text or text.endswith("\n") else "\n"
    with file.open("a", encoding="utf-8") as end:
        end.write(f"{start}{line}\n")
    return True


# Words that the Tab key completes.
#
# Nothing here starts a process or asks a network: somebody waits.


MOST_FOLDERS = 2000
"""Each takes about 20 microseconds."""

LOGS = ("sim", "trainer", "supervisor", "evaluation", "reward")
"""`sim` is a worker, `reward` what the reward function prints there."""

_CHECKPOINT = re.compile(r"(\d+)_Step-\d+\.ckpt")


def worlds() -> list[str]:
    return [
        *track_names.built_in(),
        "zoo-0",
        *track_names.own(working_folder() / (_settings().get("DR_TRACKS_DIR") or "tracks")),
    ]


def examples() -> list[str]:
    return [each.name for each in config_presets.examples()]


def docs_pages() -> list[str]:
    folder = config_presets.docs_folder()
    return sorted(str(path.relative_to(folder).with_suffix("")) for path in folder.rglob("*.md"))


def community_tracks() -> list[str]:
    return sorted(track_names.COMMUNITY - set(worlds()))


def model_prefixes() -> list[str]:
    settings = _settings()
    bucket, configured = _bucket(settings), settings.get("DR_LOCAL_S3_MODEL_PREFIX")
    models = [configured] if configured else []
    return list(dict.fromkeys(models if bucket is None else [*models, *_models_in(bucket)]))


def races() -> list[str]:
    bucket = _bucket(_settings())
    folders = [] if bucket is None else (bucket / "races").glob("*/race.json")
    return sorted(path.parent.name for path in folders)


def checkpoints() -> list[str]:
    settings = _settings()
    bucket, prefix = _bucket(settings), settings.get("DR_LOCAL_S3_MODEL_PREFIX")
    if bucket is None or not prefix:
        return list(value_types.WORDS)
    names = _names(bucket / prefix / "model")
    numbers = {int(match[1]) for name in names if (match := _CHECKPOINT.match(name))}
    return [*(str(number) for number in sorted(numbers, reverse=True)), *value_types.WORDS]


def commands() -> list[str]:
    return [command.name for command in COMMANDS if not command.hidden]


def presets() -> list[str]:
    return config_presets.preset_names()


def experiments() -> list[str]:
    return sorted(path.parent.name for path in working_folder().glob("experiments/*/run.env"))


def ready_made_models() -> list[str]:
    return list(config_presets.ready_made())


def workers() -> list[str]:
    count = _settings().get("DR_WORKERS", "1")
    sims = min(int(count), 100) if count.isdecimal() else 1
    return [*LOGS, *(f"sim-{k}" for k in range(sims))]


def race_types() -> list[str]:
    return _choices("DR_RACE_TYPE")


def clouds() -> list[str]:
    return _choices("DR_CLOUD")


def setting_names() -> list[str]:
    return sorted(config_settings.catalogue())


def explained_words() -> list[str]:
    return sorted({entry.name for entry in lookup.every_entry() if entry.kind != "error text"})


def assignments(incomplete: str) -> list[str]:
    """`NAME=`, or `NAME=VALUE` once that is typed."""
    name, is_typed, _ = incomplete.partition("=")
    if not is_typed:
        return [f"{name}=" for name in setting_names()]
    known: Mapping[str, Callable[[], list[str]]] = {
        "DR_WORLD_NAME": worlds,
        "DR_EXPERIMENT_NAME": experiments,
        "DR_LOCAL_S3_MODEL_PREFIX": model_prefixes,
        "DR_LOCAL_S3_PRETRAINED_PREFIX": model_prefixes,
    }
    return [f"{name}={value}" for value in (known[name]() if name in known else _choices(name))]


def _choices(name: str) -> list[str]:
    setting = config_settings.catalogue().get(name)
    return [] if setting is None else list(setting.choices)


def _settings() -> Mapping[str, str]:
    try:
        change = shell_variables.shell_change(working_folder(), os.environ)
    except DrError:
        return {}
    return {**activation.chosen(os.environ), **change.export}


def _bucket(settings: Mapping[str, str]) -> Path | None:
    if settings.get("DR_CLOUD", "local") != "local":
        return None
    data = working_folder() / settings.get("DR_S3_DATA_DIR", "data/s3")
    return data / settings.get("DR_LOCAL_S3_BUCKET", "bucket")


def _models_in(bucket: Path) -> Iterator[str]:
    for folder, below, _ in islice(os.walk(bucket), MOST_FOLDERS):
        if "model" in below and any(map(_CHECKPOINT.match, _names(Path(folder, "model")))):
            below.clear()
            yield Path(folder).relative_to(bucket).as_posix()
        if Path(folder) == bucket and "races" in below:
            below.remove("races")  # copies, which nobody trains on
        below.sort()


def _names(folder: Path) -> list[str]:
    try:
        return [path.name for path in folder.iterdir()]
    except OSError:
        return []
