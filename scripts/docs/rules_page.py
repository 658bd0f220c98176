"""Writes docs/validation.md from the rules."""

from drcli.checks.rules import RULES

_HEAD = """# Rules

`dr-validate` tries every rule below and reports all breaches at once; `dr-start-training` tries
those that end in errors by itself. This page is written by `scripts/docs` from
`drcli/checks/rules.py`.

The numbers are those of deepracer-on-the-spot and of the community's notes; those marked * are
ours. "For the console" means `dr-validate --console-compatible`, for a model that shall train on
DeepRacer on AWS as well.

| rule | about | demands | breach |
| --- | --- | --- | --- |
"""

_TAIL = """
## Report

Errors first, then warnings, then notes, each with its rule, place, value and remedy. A note is no
fault: it says what a start has to be told. Exit code 0 without errors, 3 with errors, 0 with
`--force`. A training need not run; where the bucket is broken or
files are missing, that is reported and all other rules are tried. Your reward function runs in a
process of its own.

`--json` prints one object on the last line of stdout:

| key | value |
| --- | --- |
| `ok` | whether nothing is wrong: a training could start, told what the notes ask for |
| `directory` | the working folder; places inside it are named from there |
| `console_compatible` | whether `--console-compatible` was given |
| `errors`, `warnings`, `notes` | lists of `{"rule", "severity", "where", "message", "remedy"}` |
| `skipped` | list of `{"rules", "reason"}`: what could not be tried |
"""


def document() -> str:
    """The page, as Markdown."""
    lines = [
        f"| {rule.number}{'' if rule.known else ' *'} | {rule.subject} | {rule.demand} "
        f"| {rule.breach} |"
        for rule in RULES
    ]
    return _HEAD + "\n".join(lines) + "\n" + _TAIL
