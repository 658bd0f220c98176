"""Command lines for every command of the table: with their own options, and values of any kind."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import typer
from hypothesis import strategies as st

import hazards
from drcli.cli.command_line import application
from drcli.cli.command_table import COMMANDS

WAITING = {"-w", "--wait", "--seconds"}
"""Options that say how long to wait; a long time is no fault."""

ENDLESS = {"--follow", "--loop"}
"""Options with which a command goes on until somebody stops it."""


@dataclass(frozen=True)
class Form:
    """A command and the parameters that it takes, as Typer knows them."""

    words: tuple[str, ...]
    parameters: tuple[Any, ...]

    @property
    def name(self) -> str:
        """The command as somebody types it."""
        return " ".join(self.words)


@cache
def forms() -> tuple[Form, ...]:
    """Every command, and every command of a group."""
    found = (form for command in COMMANDS for form in _forms_of(command.name))
    return tuple(
        replace(form, parameters=tuple(p for p in form.parameters if not ENDLESS & {*p.opts}))
        for form in found
    )


def _forms_of(name: str) -> Iterator[Form]:
    group: Any = typer.main.get_command(application([name]))
    loaded = group.commands[name]
    if hasattr(loaded, "commands"):
        for inner, single in loaded.commands.items():
            yield Form((name, inner), tuple(single.params))
    else:
        yield Form((name,), tuple(loaded.params))


def lines_for(form: Form) -> st.SearchStrategy[list[str]]:
    """Command lines for one command: mostly its own options, mostly with wrong values."""

    @st.composite
    def line(draw: st.DrawFn) -> list[str]:
        words = list(form.words)
        chosen = (
            draw(st.lists(st.sampled_from(form.parameters), max_size=4)) if form.parameters else []
        )
        options = [p for p in chosen if p.param_type_name == "option"]
        arguments = [p for p in form.parameters if p.param_type_name == "argument"]
        for parameter in options:
            words += draw(_option(parameter))
        for parameter in arguments:
            if draw(st.integers(0, 9)):
                words.append(draw(_value(parameter)))
        if not draw(st.integers(0, 6)):
            words.insert(draw(st.integers(1, len(words))), draw(hazards.anything))
        return words

    return line().filter(lambda words: all(map(hazards.in_environment, words)))


def _option(parameter: Any) -> st.SearchStrategy[list[str]]:
    names = st.sampled_from([*parameter.opts, *parameter.secondary_opts])
    if getattr(parameter, "is_flag", False):
        return names.map(lambda name: [name])
    value = _value(parameter)
    apart = st.tuples(names, value).map(list)
    joined = st.tuples(names, value).map(lambda pair: ["=".join(pair)])
    return st.one_of(apart, apart, joined)


def _value(parameter: Any) -> st.SearchStrategy[str]:
    wanted = parameter.type_descriptor.annotation
    if WAITING & set(parameter.opts) and wanted is float:
        return st.sampled_from(["0", "0.1", "-1", "nan", "x", "", "1e-320"])
    if get_origin(wanted) is Literal:
        return st.one_of(st.sampled_from(get_args(wanted)), hazards.texts)
    if wanted in (int, float):
        return st.one_of(hazards.numbers, hazards.numbers, hazards.texts)
    if wanted is Path:
        return st.one_of(hazards.paths, hazards.paths, hazards.texts)
    return st.one_of(hazards.texts, hazards.texts, hazards.paths, hazards.numbers)
