"""No command line ends in a traceback, hangs, or leaves half of a change behind."""

import os

import pytest

from command_lines import forms, lines_for
from exploring import explore

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(0)]

FORMS = forms()
SHARE = 0.4
"""Of the time of the long form, for all command lines together."""


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_any_options_and_arguments(space, form):
    def check(words: list[str]) -> None:
        space.restore()
        _lay_down_traps(space)
        space.call(words)

    explore(lines_for(form), check, few=1, share=SHARE / len(FORMS))


def _lay_down_traps(space) -> None:
    """Files that no command can do anything with."""
    given = space.folder / "given"
    (given / "loop").symlink_to("loop")
    (given / "dangling").symlink_to("nowhere")
    os.mkfifo(given / "fifo")
    (given / "unreadable").write_text("DR_WORLD_NAME=reinvent_base\n")
    (given / "unreadable").chmod(0)
    (given / "empty").touch()
    (given / "binary").write_bytes(bytes(range(256)))
