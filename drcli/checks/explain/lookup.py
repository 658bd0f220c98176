"""Finds what is known about a word, however it is written."""

import difflib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import Annotated, Literal

from drcli.base.errors import SettingsError
from drcli.base.report import Styled, View, bold, dim
from drcli.checks.explain.explain_texts import (
    ERROR_TEXTS,
    EXIT_CODES,
    GLOSSARY,
    TRACE_COLUMNS,
    ErrorText,
)
from drcli.config.presets import docs_folder, model_file
from drcli.config.settings import catalogue
from drcli.learn.algorithms import ALGORITHMS, UPDATES_PER_STEP
from drcli.model.files.hyperparameters import SYNONYMS, TEXTS, Hyperparameters
from drcli.model.files.sensors import SENSORS
from drcli.records.trace import CSV_HEADER
from drcli.rewards.reward_parameter_texts import REWARD_PARAMETERS

# What is known about one word.


Kind = Literal[
    "hyperparameter",
    "setting",
    "term",
    "reward parameter",
    "trace column",
    "exit code",
    "error text",
    "rule",
    "finding",
]


@dataclass(frozen=True)
class Detail:
    """One more thing about a word."""

    label: Annotated[str, 'What it is about, such as "Higher".']
    text: Annotated[str, "The text."]


@dataclass(frozen=True)
class Entry:
    """What is known about one word."""

    kind: Annotated[Kind, "What the word is."]
    name: Annotated[str, "The word, as it is written in files, or an error text."]
    meaning: Annotated[str, "What it means, in a sentence or two."]
    details: Annotated[tuple[Detail, ...], "More about it, in the order to show."] = ()
    page: Annotated[str, "Page in docs/ that says more."] = ""

    def parts(self) -> View:
        details = (
            (Styled(f"{each.label}: ", "cyan"), _without_ticks(each.text)) for each in self.details
        )
        title = (bold(self.name), dim(f"  {self.kind}"))
        page = self.page.removesuffix(".md")
        return title, [_without_ticks(self.meaning), *details, dim(f"More: dr docs {page}")]


SHORTEST_PART = 4
MOST_FOUND = 12
LONGEST = 500
CLOSE = 0.7
_PAGE_LINK = re.compile(r"\[([a-z0-9-]+)\.md\]\([^)]*\)")
_LINK = re.compile(r"\[([^]]*)\]\([^)]*\)")


def explain(question: str) -> list[Entry]:
    """What is known about a word, in any spelling, or a piece of an error text.

    Raises:
        SettingsError: Nothing is known; the remedy names words that look alike.
    """
    wanted = _plain(question[:LONGEST])
    if not wanted:
        raise _unknown(question, [])
    forms = {wanted, wanted.removesuffix("s")}
    exact = [entry for name, entry in _by_name() if name in forms]
    if exact:
        return [*exact, *_similar(wanted, exact)]
    errors = [_error(text) for text in ERROR_TEXTS if _is_about(text, question[:LONGEST])]
    if errors:
        return errors
    parts = [entry for name, entry in _by_name() if wanted in name]
    if len(wanted) >= SHORTEST_PART and 0 < len(parts) <= MOST_FOUND:
        return list(dict.fromkeys(parts))
    names = {name: entry.name for name, entry in _by_name()}
    close = difflib.get_close_matches(wanted, names, n=3, cutoff=CLOSE)
    raise _unknown(question, [names[name] for name in close])


def _similar(wanted: str, found: list[Entry]) -> list[Entry]:
    """Keys and settings named with a word that other programs use: it may mean them as well."""
    if not any(wanted in map(_plain, SYNONYMS.get(entry.name, ())) for entry in found):
        return []
    named = [entry for entry in every_entry() if f" {wanted} " in f" {_plain(entry.name)} "]
    kinds = ("hyperparameter", "setting")
    return [entry for entry in named if entry not in found and entry.kind in kinds]


def every_entry() -> tuple[Entry, ...]:
    return (
        *map(_hyperparameter, TEXTS),
        *(Entry("term", name, text, page="glossary.md") for name, text in GLOSSARY.items()),
        *(
            Entry("term", name, _sentence(f"A sensor: {sensor.words}"), page="action-space.md")
            for name, sensor in SENSORS.items()
        ),
        *map(_parameter, REWARD_PARAMETERS),
        *(
            Entry("trace column", name, TRACE_COLUMNS[name], page="glossary.md")
            for name in CSV_HEADER.split(",")
        ),
        *(
            Entry("exit code", str(code), _sentence(text), page="commands.md")
            for code, text in EXIT_CODES.items()
        ),
        *map(_setting, catalogue()),
        *_told_on_pages(),
        *map(_error, ERROR_TEXTS),
    )


@cache
def _by_name() -> tuple[tuple[str, Entry], ...]:
    return tuple((name, entry) for entry in every_entry() for name in _names(entry))


def _names(entry: Entry) -> Iterator[str]:
    yield _plain(entry.name)
    if entry.kind == "hyperparameter":
        yield from map(_plain, SYNONYMS.get(entry.name, ()))
    if entry.kind == "setting":
        yield _plain(entry.name.removeprefix("DR_"))
        yield from map(_plain, catalogue()[entry.name].old_names)
        yield from map(_plain, catalogue()[entry.name].choices)
    if entry.kind == "exit code":
        yield f"exit code {entry.name}"
        yield f"code {entry.name}"


def _plain(text: str) -> str:
    return " ".join(re.sub(r"[_\-\s]+", " ", text.strip("`'\" .,:;?!$")).casefold().split())


def _is_about(text: ErrorText, question: str) -> bool:
    wanted, whole = _letters(question), _letters(text.text)
    if len(wanted) < SHORTEST_PART:
        return False
    pieces = [_letters(piece) for piece in text.text.split("...")]
    long = [piece for piece in pieces if len(piece) >= SHORTEST_PART]
    return wanted in whole or _in_order(long, wanted)


def _in_order(pieces: list[str], text: str) -> bool:
    at = 0
    for piece in pieces:
        at = text.find(piece, at)
        if at < 0:
            return False
        at += len(piece)
    return bool(pieces)


def _letters(text: str) -> str:
    return " ".join(re.sub(r"[^\w/]+", " ", text.casefold()).split())


def _hyperparameter(key: str) -> Entry:
    text = TEXTS[key]
    details = [
        *_details(("Higher" if text.lower else "Effect", text.higher), ("Lower", text.lower)),
        *_details(("Advice", text.advice), ("Shipped value", shipped_value(key))),
        Detail("If left out", value_if_left_out(key)),
    ]
    return Entry("hyperparameter", key, text.meaning, tuple(details), "hyperparameters.md")


def _without_links(text: str) -> str:
    return _LINK.sub(r"\1", _PAGE_LINK.sub(r"`dr docs \1`", text))


def _details(*pairs: tuple[str, str]) -> Iterator[Detail]:
    return (Detail(label, text) for label, text in pairs if text)


def value_if_left_out(key: str) -> str:
    """What a training takes for a hyperparameter, "off" if nothing."""
    if key == "sac_updates_per_step":
        return f"{UPDATES_PER_STEP['cpu']:g}, or {UPDATES_PER_STEP['cuda']:g} on a GPU"
    default = Hyperparameters.model_fields[key].default
    own = (getattr(each.config(), key, None) for each in ALGORITHMS.values())
    found = (value for value in (default, *own) if value is not None)
    return _value(next(found, None)) or "off"


def shipped_value(key: str) -> str:
    return _value(shipped_values().get(key))


@cache
def shipped_values() -> Mapping[str, object]:
    return dict(json.loads(model_file("hyperparameters.json").read_text("utf-8")))


def _value(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:g}"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _setting(name: str) -> Entry:
    setting = catalogue()[name]
    if setting.effect != "used":
        details = _details(("Here", f"No effect: {setting.reason}"))
    else:
        default = setting.default_text
        details = _details(
            ("Default", default or "none"),
            ("Allowed", setting.expected),
            ("File", setting.file),
            ("Old name", ", ".join(setting.old_names)),
        )
    return Entry("setting", name, _sentence(setting.meaning), tuple(details), "settings.md")


def _parameter(name: str) -> Entry:
    text = REWARD_PARAMETERS[name]
    meaning = _sentence(_without_links(text.meaning).replace("**", ""))
    details = _details(("Type", text.kind), ("Unit", text.unit.replace("**", "")))
    return Entry("reward parameter", name, meaning, tuple(details), "reward-functions.md")


def _error(text: ErrorText) -> Entry:
    details = (Detail("With drcli", _sentence(_without_links(text.here))),)
    return Entry("error text", text.text, _sentence(text.reason), details, "troubleshooting.md")


PAGES = ("validation.md", "reward-functions.md", "car.md", "analysis.md", "advice.md", "doctor.md")
_TABLE = re.compile(r"(?m)(?:^\|.*\n)+")
_CODE = re.compile(r"[A-Z]-[0-9]{2}")


def _told_on_pages() -> Iterator[Entry]:
    """The rules, and what a check or an analysis finds, as the tables of our pages tell them."""
    for page in PAGES:
        text = (docs_folder() / page).read_text("utf-8")
        found: dict[tuple[Kind, str], list[list[str]]] = {}
        for table in _TABLE.findall(text):
            head, _, *rows = [
                [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|\n"))]
                for line in table.splitlines()
            ]
            for first, *cells in rows:
                if code := _CODE.match(first):
                    found.setdefault(("rule", code[0]), []).append(cells)
                elif head[0] in ("warning", "advice", "word", "subject"):
                    told = ["`dr-doctor` examines", *cells] if head[0] == "subject" else cells
                    for name in re.findall(r"`([a-z_-]+)`", first) or [first]:
                        found.setdefault(("finding", name), []).append(told)
        for (kind, name), rows in found.items():
            first, *more = (
                _without_links(": ".join(filter(None, cells))).replace("\\|", "|") for cells in rows
            )
            details = tuple(Detail("Also", _sentence(each)) for each in more)
            yield Entry(kind, name, _sentence(first), details, page)


def _sentence(text: str) -> str:
    text = text.strip()
    begin = text[:1] if text.startswith(("`", "drcli")) else text[:1].upper()
    return f"{begin}{text[1:]}" + ("" if text.endswith((".", "!", "?", ")")) else ".")


def _unknown(question: str, close: list[str]) -> SettingsError:
    shown = question if len(question) <= 60 else f"{question[:57]}..."
    offer = f"Did you mean {', '.join(close)}? " if close else ""
    return SettingsError(
        f"Nothing is known about '{shown}'.",
        remedy=f"{offer}`dr-explain` without a name lists all words.",
    )


# The report of `dr-explain`.


_HEADINGS = {
    "hyperparameter": "Hyperparameters",
    "term": "Terms",
    "reward parameter": "Parameters of reward functions",
    "trace column": "Columns of traces",
    "exit code": "Exit codes",
    "setting": "Settings",
    "rule": "Rules",
    "finding": "Findings of checks and analyses",
    "error text": "Error texts of other programs",
}


def _without_ticks(text: str) -> str:
    return text.replace("`", "")


@dataclass(frozen=True)
class Explanation:
    """What is known about a word."""

    question: Annotated[str, "What was asked for; empty for everything."]
    entries: Annotated[list[Entry], "What is known about it; a word may have several meanings."]

    @staticmethod
    def of(question: str) -> "Explanation":
        """Look a word up.

        Raises:
            SettingsError: Nothing is known about it.
        """
        found = explain(question) if question.strip() else every_entry()
        return Explanation(question, list(found))

    def view(self) -> View:
        if self.question.strip():
            yield from chain.from_iterable(entry.parts() for entry in self.entries)
            return
        for kind, heading in _HEADINGS.items():
            names = list(dict.fromkeys(entry.name for entry in self.entries if entry.kind == kind))
            yield from (bold(heading), names if kind == "error text" else [", ".join(names)])
