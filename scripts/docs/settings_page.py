"""Writes docs/settings.md from the declared settings."""

from collections.abc import Iterable, Sequence
from itertools import groupby

from drcli.config.fields import Setting
from drcli.config.loading import WORKER_NAMES, WORKER_STEMS
from drcli.config.settings import catalogue
from drcli.config.unused_names import FORMER

HEAD = """\
# Settings

Every `DR_` setting. `scripts/docs` writes this page from the declarations in
`drcli/config/groups/`: change those.

`run.env` and `system.env` contain `NAME=value` lines. You can write a setting in either file; the
last column of the tables shows the usual one, and `dr config set NAME=VALUE` writes it there. If a
setting is given in several places, the first of these applies: flag, process environment,
`run.env`, `system.env`, default. An experiment has its own `run.env` in `experiments/<name>/`.

- Values may contain spaces and `=`. ` #` starts a comment, so put a value with it in quotes.
- `$NAME` and `${NAME}` are replaced by the value of that name, wherever it is set.
  `${NAME:-other}` is `other` if the name is not set or empty. In single quotes `$` has no special
  meaning.
- True is also `true`, `yes`, `on` and `1`; False is `false`, `no`, `off` and `0`. Words such as
  `TIME_TRIAL` may be written in any letter case.
- An empty value is the same as no value.
- A misspelt name is an error; any other unknown name only gives a warning.

`dr config show` prints each value with its file and line. `dr config check` lists everything that
is wrong, odd or without effect.
"""

WORKERS = """\
## worker-N.env

With `DR_TRAIN_MULTI_CONFIG=True`, the second and all further workers read `worker-2.env`,
`worker-3.env` and so on, in the folder of the active `run.env`. Such a file has the same format and
overrides all other settings for its worker. It may contain
"""

UNUSED = """\
## Accepted without effect

Names of the reference that do nothing here. They may stay in your files; `dr config check` lists
those that it finds. When a training starts, one line warns about them; it names those that you may
rely on.
"""


def document() -> str:
    """The page, as Markdown."""
    settings = list(catalogue().values())
    used = [setting for setting in settings if setting.effect == "used"]
    unused = [setting for setting in settings if setting.effect != "used"]
    parts = [HEAD]
    for title, group in groupby(used, lambda setting: setting.group):
        rows = ((_name(s), _code(s.default_text), _meaning(s), s.expected, s.file) for s in group)
        header = ("name", "default", "meaning", "allowed values", "file")
        parts.append(f"## {title}\n\n{_table(header, rows)}")
    parts.append(_workers())
    rows_without = [(_name(s), s.meaning, s.reason) for s in unused]
    rows_without += [(f"`{name}`", old.meaning, old.reason) for name, old in FORMER.items()]
    parts.append(f"{UNUSED}\n{_table(('name', 'in the reference', 'reason'), rows_without)}")
    return "\n".join(parts)


def _workers() -> str:
    names = [f"`{name}`" for name in WORKER_NAMES]
    stems = [f"`{stem}`" for stem in WORKER_STEMS]
    return f"{WORKERS}{', '.join(names)}, and all names that start with {', '.join(stems)}.\n"


def _name(setting: Setting) -> str:
    return f"`{setting.name}`"


def _meaning(setting: Setting) -> str:
    if not setting.old_names:
        return setting.meaning
    old = ", ".join(f"`{name}`" for name in setting.old_names)
    return f"{setting.meaning} Old name: {old}."


def _code(text: str) -> str:
    return f"`{text}`" if text else ""


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(map(_cell, cells))} |\n" for cells in lines)


def _cell(text: str) -> str:
    return text.replace("|", r"\|")
