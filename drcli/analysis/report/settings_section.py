"""The settings of a training, and what differs from its parent."""

import difflib
import json
from collections.abc import Iterator, Mapping

from drcli.analysis.report.markup import Content, Html, coloured_difference, element, table
from drcli.analysis.report.section import Section
from drcli.analysis.run import Run
from drcli.modelfiles.action_space import ActionSpace

_TABLES = ("hyperparameters.json", "model_metadata.json", "settings")


def settings_section(run: Run) -> Section | None:
    content: list[Content] = [*_differences(run)]
    if run.hyperparameters:
        rows = [[name, _value(value)] for name, value in sorted(run.hyperparameters.items())]
        content.append(table("Hyperparameters", ["name", "value"], rows, texts=2))
    if run.actions is not None:
        content.append(_actions(run.actions))
    for name, text in sorted(run.files.items()):
        if name in ("hyperparameters.json", "model_metadata.json") and _parsed(text):
            continue
        shown = element("pre", element("code", text))
        content.append(element("details", element("summary", name), shown))
    if not content:
        return None
    look = (
        "Look at what changed since the parent model: a change of one thing at a time can be "
        "judged, several at once cannot."
        if run.parent
        else "Look up here what this training was driven with before you compare it with another."
    )
    return Section("settings", "Settings", "Settings", look, tuple(content))


def _differences(run: Run) -> Iterator[Html]:
    if run.parent is None:
        return
    yield element("h3", "Compared with its parent, ", element("code", run.parent))
    if not run.parent_files:
        yield element("p", "The files of that model could not be read, so nothing is compared.")
        return
    same = True
    rows: list[list[Content]] = []
    for name in _TABLES:
        if name not in run.files or name not in run.parent_files:
            continue
        before, now = _values(run.parent_files[name]), _values(run.files[name])
        rows += [
            [key, before.get(key, "(not set)"), now.get(key, "(not set)")]
            for key in sorted({*before, *now})
            if before.get(key) != now.get(key)
        ]
    if rows:
        same = False
        yield table("Values that differ", ["name", "parent", "this model"], rows, texts=3)
    for name in sorted({*run.files, *run.parent_files} - {*_TABLES}):
        before_text, now_text = run.parent_files.get(name, ""), run.files.get(name, "")
        if before_text != now_text:
            same = False
            yield element("h3", name)
            yield _line_difference(before_text, now_text)
    if same:
        yield element("p", "All files and settings that could be read are the same.")


def _line_difference(before: str, now: str) -> Html:
    lines = difflib.unified_diff(
        before.splitlines(), now.splitlines(), "parent", "this", n=2, lineterm=""
    )
    return coloured_difference(list(lines)[2:])


def _actions(space: ActionSpace) -> Html:
    if space.low is not None and space.high is not None:
        rows = [
            [name, f"{low:g}", f"{high:g}"]
            for name, low, high in zip(
                ("steering (degrees, left positive)", "speed (m/s)"),
                space.low,
                space.high,
                strict=True,
            )
        ]
        return table("Continuous actions", ["quantity", "low", "high"], rows)
    listed = [
        [str(number), f"{steering:g}", f"{speed:g}"]
        for number, (steering, speed) in enumerate(space.values)
    ]
    found = table(
        "Action space", ["action", "steering (degrees, left positive)", "speed (m/s)"], listed
    )
    return element("details", element("summary", f"{len(listed)} actions"), found)


def _values(text: str) -> dict[str, str]:
    """Of JSON by path, of NAME=VALUE lines by name."""
    parsed = _parsed(text)
    if parsed is not None:
        return dict(_flat(parsed, ""))
    pairs = (line.partition("=") for line in text.splitlines() if "=" in line)
    return {
        name.removeprefix("export ").strip(): value.strip()
        for name, _, value in pairs
        if not name.startswith("#")
    }


def _flat(value: object, path: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _flat(part, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for number, part in enumerate(value):
            yield from _flat(part, f"{path}[{number}]")
    else:
        yield path, _value(value)


def _parsed(text: str) -> dict[str, object] | list[object] | None:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict | list) else None


def _value(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
