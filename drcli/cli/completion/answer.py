"""The program that a shell asks when somebody presses Tab: `drcli-complete SHELL WORD...`.

It answers one candidate a line, `word<Tab>what it is`, and nothing where file names are as good.
Typer's own mechanism is not used: it loads pydantic and Rich, and that takes longer than anybody
waits for a key.
"""

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from drcli.base.errors import DrError
from drcli.cli.completion.values import Place
from drcli.cli.table import COMMANDS, Command, program_names
from drcli.cli.working_folder import working_folder

Candidate = tuple[str, str]
"""A word and what it is."""


def main() -> None:
    """Answer a shell: its name, the program that is called, and all words up to the cursor."""
    shell, program, *words = sys.argv[1:]
    typed = _joined(words)
    with suppress(DrError):  # the command itself will say what is wrong
        for word, meaning in candidates(Path(program).name, typed[:-1], typed[-1] if typed else ""):
            if shell == "bash":  # it takes the part behind the = for a word of its own
                word = word[_break(typed[-1]) :]
            print(f"{word}\t{meaning}" if meaning else word)


def candidates(program: str, words: list[str], incomplete: str) -> list[Candidate]:
    """What may follow.

    Args:
        program: Name of the program that is called, as `dr-status`.
        words: Complete words behind it.
        incomplete: What stands of the word at the cursor.
    """
    name = program_names().get(program, program.removeprefix("dr-"))
    line = [*([name] if name else []), *words]
    if not line:
        found: Iterable[Candidate] = _commands()
    else:
        command = next((command for command in COMMANDS if command.name == line[0]), None)
        found = _of_command(command, line[1:], incomplete) if command is not None else ()
    return [pair for pair in found if pair[0].startswith(incomplete)]


def _commands() -> Iterator[Candidate]:
    for command in COMMANDS:
        if not command.hidden:
            yield command.name, command.help
    yield from (("--help", "Show this message and exit."), ("--version", "Show the version."))


def _of_command(command: Command, words: list[str], incomplete: str) -> Iterator[Candidate]:
    from drcli.cli.lazy import load

    target, path = load(command), command.name
    while hasattr(target, "commands"):  # a group: its next word is a command
        words = [word for word in words if not word.startswith("-")]
        if not words:
            yield from ((name, _first_line(sub.help)) for name, sub in target.commands.items())
            return
        target, path, words = target.commands.get(words[0]), f"{path} {words[0]}", words[1:]
    if target is not None:
        yield from _of_parameters(path, target.params, words, incomplete)


def _of_parameters(
    path: str, parameters: list[Any], words: list[str], incomplete: str
) -> Iterator[Candidate]:
    from drcli.cli.completion.places import values_of

    options = {
        spelling: parameter
        for parameter in parameters
        if parameter.param_type_name == "option"
        for spelling in (*parameter.opts, *parameter.secondary_opts)
    }
    arguments = [p for p in parameters if p.param_type_name == "argument"]
    used, waiting, behind = _read(words, options)
    place = Place(working_folder(), incomplete)
    if waiting is not None:
        yield from ((word, "") for word in values_of(path, waiting, place))
    elif incomplete.startswith("-"):
        spare = [o for o in options.values() if not o.hidden and (o.multiple or o.name not in used)]
        yield from ((_longest(option.opts), _first_line(option.help)) for option in _once(spare))
        yield "--help", "Show this message and exit."
    elif arguments and (behind < len(arguments) or arguments[-1].nargs == -1):
        argument = arguments[min(behind, len(arguments) - 1)]
        yield from ((word, "") for word in values_of(path, argument, place))


def _read(words: list[str], options: dict[str, Any]) -> tuple[set[str], Any, int]:
    """Which options are there, which of them waits for its value, and how many arguments."""
    used: set[str] = set()
    waiting: Any = None
    behind = 0
    for word in words:
        if waiting is not None:
            waiting = None
            continue
        if not word.startswith("-"):
            behind += 1
            continue
        # -wq is -w -q, and --name=value needs no further word.
        spellings = [word] if word.startswith("--") else [f"-{letter}" for letter in word[1:]]
        for spelling in spellings:
            option = options.get(spelling.partition("=")[0])
            if option is not None:
                used.add(option.name)
                waiting = None if option.is_flag or "=" in word else option
    return used, waiting, behind


def _joined(words: list[str]) -> list[str]:
    """Words as they were typed: bash takes NAME=value apart, and hands out open quotes."""
    joined: list[str] = []
    glue = False
    for word in words:
        if word == "=" and joined:
            joined[-1] += "="
            glue = True
        elif glue:
            joined[-1] += word
            glue = False
        else:
            joined.append(word.strip("\"'"))
    return joined


def _break(incomplete: str) -> int:
    return incomplete.rfind("=") + 1


def _once(options: list[Any]) -> list[Any]:
    return list({option.name: option for option in options}.values())


def _longest(spellings: list[str]) -> str:
    return max(spellings, key=len)


def _first_line(text: str | None) -> str:
    return (text or "").strip().partition("\n")[0]


if __name__ == "__main__":
    try:
        main()
    except BrokenPipeError:
        os._exit(0)
