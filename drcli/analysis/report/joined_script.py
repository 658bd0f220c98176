"""Joins modules of the pages into one script, for a file that loads nothing."""

import re
from importlib.resources import files

_IMPORT = re.compile(r'^import (\{[^}]*\}|\* as \w+) from "(/[^"]+)";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const) (\w+))", re.MULTILINE)
_ALL = re.compile(r'^export \* from "(/[^"]+)";$', re.MULTILINE)
_LIST = re.compile(r"\bexport\s*\{([^}]*)\};?\s*$")
_OTHER = re.compile(
    r"^(?:import|export)\b.*|^[^*/\n]*(?:\bimport\s*\(|\b(?:im|ex)port\s*\{).*", re.MULTILINE
)


def joined_script(entry: str) -> str:
    """A script that does what a module does, with all modules that it imports.

    Each becomes a function that returns what it exports, and is called once, after those that it
    needs: `import { a as b } from "/c.js"` becomes `const { a: b } = modules["/c.js"]`.

    Raises:
        ValueError: A module uses another form of `import` or `export`, or needs itself.
    """
    parts: dict[str, str] = {}
    _add(entry, parts, ())
    return (
        '"use strict";\n(() => {\nconst modules = {};\n' + "\n".join(parts.values()) + "\n})();\n"
    )


def page_file(name: str) -> str:
    """The text of a file of the report, or of the pages of the console."""
    own = files("drcli.analysis.report") / "assets" / name
    path = own if own.is_file() else files("drcli").joinpath("web", "pages", *name.split("/"))
    return path.read_text("utf-8")


def _add(path: str, parts: dict[str, str], above: tuple[str, ...]) -> None:
    if path in parts:
        return
    if path in above:
        raise ValueError(f"{path} needs itself: {', '.join(above)}.")
    text = page_file(path.removeprefix("/"))
    for needed in [*(found[2] for found in _IMPORT.finditer(text)), *_ALL.findall(text)]:
        _add(needed, parts, (*above, path))
    exported = [f'...modules["{name}"]' for name in _ALL.findall(text)] + _EXPORT.findall(text)
    for names in _LIST.findall(text):
        exported += [_property(name) for name in names.split(",")]
    text = _IMPORT.sub(_taken, _LIST.sub("", _ALL.sub("", _EXPORT.sub("", text))))
    if other := _OTHER.search(text):
        raise ValueError(f"{path} cannot be joined with others: {other[0]}")
    body = f"{text}\nreturn {{ {', '.join(exported)} }};"
    parts[path] = f'modules["{path}"] = (() => {{\n{body}\n}})();'


def _taken(found: re.Match[str]) -> str:
    taken = found[1].removeprefix("* as ").replace(" as ", ": ")
    return f'const {taken} = modules["{found[2]}"];'


def _property(name: str) -> str:
    """Of `here as there` in a list of exports: what the function returns of it."""
    here, _, there = name.strip().partition(" as ")
    return f"{there}: {here}" if there else here
