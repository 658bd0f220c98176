"""Makes new shells load the completion: a file of ours, and one line in a start file."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.cli.completion.scripts import SHELLS, Shell, script


@dataclass(frozen=True)
class Installed:
    """Where the completion lies.

    Attributes:
        shell: bash, zsh or fish.
        script: The file that was written.
        start_file: The shell's own file that loads it; None for fish, which needs no line.
        added: Whether a line was added to that file; it stands there once at most.
    """

    shell: Shell
    script: str
    start_file: str | None
    added: bool


def shell_of(environ: Mapping[str, str]) -> Shell:
    """The shell of this user.

    Raises:
        SettingsError: It is none that we know.
    """
    name = Path(environ.get("SHELL", "")).name
    for shell in SHELLS:
        if name == shell:
            return shell
    raise SettingsError(
        f"SHELL={name or '(nothing)'} is none of {', '.join(SHELLS)}.",
        remedy="Name the shell, as in `dr completion install bash`.",
    )


def install(shell: Shell, environ: Mapping[str, str]) -> Installed:
    """Write the script and let new shells load it. Doing it again changes nothing.

    Raises:
        SettingsError: A file cannot be written, or the user has no home.
    """
    try:
        home = Path(environ.get("HOME") or Path.home())
    except RuntimeError:
        raise SettingsError(
            "The home folder of this user is not known, so there is no place for completion.",
            remedy=f"Set HOME, or put what `dr completion show {shell}` prints where your shell "
            "reads it.",
        ) from None
    path = _script_file(shell, home, environ)
    start_file = {"bash": home / ".bashrc", "zsh": Path(environ.get("ZDOTDIR") or home) / ".zshrc"}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(script(shell), "utf-8")
        added = shell in start_file and _add_line(start_file[shell], path)
    except OSError as e:
        raise SettingsError(
            f"{e.filename or path}: cannot be written ({e.strerror or e}).",
            remedy=f"Put what `dr completion show {shell}` prints where your shell reads it.",
        ) from e
    line_in = start_file.get(shell)
    return Installed(shell, str(path), str(line_in) if line_in is not None else None, added)


def _script_file(shell: Shell, home: Path, environ: Mapping[str, str]) -> Path:
    if shell == "fish":  # read by every new fish
        folder = Path(environ.get("XDG_CONFIG_HOME") or home / ".config")
        return folder / "fish" / "conf.d" / "drcli.fish"
    folder = Path(environ.get("XDG_DATA_HOME") or home / ".local" / "share")
    return folder / "drcli" / f"completion.{shell}"


def _add_line(file: Path, path: Path) -> bool:
    line = f"if [ -r {shlex.quote(str(path))} ]; then . {shlex.quote(str(path))}; fi"
    text = file.read_text("utf-8", "surrogateescape") if file.exists() else ""
    if line in text.splitlines():
        return False
    start = "" if not text or text.endswith("\n") else "\n"
    with file.open("a", encoding="utf-8") as end:
        end.write(f"{start}{line}\n")
    return True
