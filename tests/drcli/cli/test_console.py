"""What goes to stdout, what to stderr, and in which shape."""

import io
import json
import re
from dataclasses import dataclass

import pytest
from rich.console import Console

from drcli.cli import terminal


@dataclass(frozen=True)
class Weather:
    """A report."""

    degrees: list[float]

    @property
    def warm(self) -> bool:
        """A sentence about the rest."""
        return self.degrees[0] > 20


class Terminal:
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_json_holds_fields_and_properties_of_a_report(monkeypatch, capsys):
    monkeypatch.setattr(terminal, "as_json", True)
    terminal.emit(Weather([25.0]), "warm")

    printed = capsys.readouterr()
    assert json.loads(printed.out) == {"degrees": [25.0], "warm": True}
    assert printed.err == ""


def test_numbers_that_json_does_not_know_become_null(monkeypatch, capsys):
    monkeypatch.setattr(terminal, "as_json", True)
    terminal.emit(Weather([float("nan"), float("inf")]), "")

    assert json.loads(capsys.readouterr().out)["degrees"] == [None, None]


def test_a_pipe_gets_the_rendered_report_in_whole_lines_without_blanks_at_their_end(capsys):
    terminal.emit(Weather([25.0]), "warm " * 40)

    assert capsys.readouterr().out == ("warm " * 40).rstrip() + "\n"


def test_a_report_is_printed_as_it_is_whatever_stands_in_its_names(capsys):
    terminal.emit(Weather([25.0]), "/a [red]/:car:/run.env")
    terminal.say("/a [red]/:car:/run.env")

    printed = capsys.readouterr()
    assert printed.out == printed.err == "/a [red]/:car:/run.env\n"


LONG = (
    "The physical car and DeepRacer on AWS run this model and DeepRacer-for-Cloud too, see "
    "/home/racer/my-racer/custom_files/reward_function.py line 3; `dr export droa --distill` makes "
    "another network of it, and `dr-start-training --resume` trains the whole model further."
)


@pytest.mark.parametrize("columns", [40, 60, 80, 120])
@pytest.mark.parametrize(
    ("show", "label"),
    [
        (terminal.say, ""),
        (terminal.warn, "Warning: "),
        (lambda text: terminal.fail(text, ""), "Error: "),
        (lambda text: terminal.fail("Broken.", text), "Error: Broken.\n  Try: "),
    ],
)
def test_messages_break_between_words_and_never_within_a_command(monkeypatch, columns, show, label):
    with io.StringIO() as screen:
        screen.isatty = lambda: True
        console = terminal.Console(file=screen, width=columns, highlight=False, color_system=None)
        monkeypatch.setattr(terminal, "err", console)
        show(LONG)
        printed = screen.getvalue()

    lines = printed.splitlines()
    pieces = re.findall(r"`[^`]*`\S*|\S+", LONG)
    assert printed.replace("\n", " ").strip() == f"{label}{LONG}".replace("\n", " ")
    assert all(any(piece in line for line in lines) for piece in pieces)
    assert all(len(line) <= columns or " " not in line.strip() for line in lines)


def test_lines_and_columns_of_a_message_are_kept(monkeypatch):
    monkeypatch.setattr(terminal, "err", terminal.Console(file=Terminal(), width=40))

    assert terminal.in_lines("  a   b\n\n  c\td") == "  a   b\n\n  c\td"


def test_each_of_several_failures_is_followed_by_its_own_remedy(capsys):
    terminal.fail("One broke.\nTwo broke.\nAnd 3 more like these.", "Mend one.\nMend two.")

    assert capsys.readouterr().err.splitlines() == [
        "Error: One broke.",
        "  Try: Mend one.",
        "Error: Two broke.",
        "  Try: Mend two.",
        "Error: And 3 more like these.",
    ]


@pytest.mark.parametrize(("known", "columns"), [("100", 100), ("10", 80)])
def test_results_fill_the_columns_of_a_terminal(monkeypatch, known, columns):
    monkeypatch.setenv("COLUMNS", known)
    monkeypatch.setattr("sys.stdout", Terminal())

    assert terminal.columns() == columns


def test_results_are_not_folded_in_a_pipe(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "100")

    assert terminal.columns() == terminal.BOUNDLESS


def test_hints_warnings_and_failures_go_to_stderr_as_they_are_written(working_folder, capsys):
    terminal.say("[bold] is no markup")
    terminal.warn("odd [value]")
    terminal.fail("It broke [here].", "Mend it.")
    terminal.suggest([("dr-status", "look")])

    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.splitlines() == [
        "[bold] is no markup",
        "Warning: odd [value]",
        "Error: It broke [here].",
        "  Try: Mend it.",
        "Next:",
        "  look:",
        "    dr-status",
    ]


class Screen(io.StringIO):
    """A terminal that keeps what it shows."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_gets_whole_words_and_commands_in_one_piece(monkeypatch):
    screen = Screen()
    monkeypatch.setattr(terminal, "err", Console(file=screen, width=40, color_system=None))
    address = "s3://bucket/a-model-with-a-name/that/is/longer/than/a/line"

    terminal.say(f"Takes a checkpoint of the model {address} and its median-lap.\n   a list")
    terminal.warn("A warning that goes on until a word has no room.")
    terminal.fail("One [thing] broke.", "Run `dr-start-training --resume-or-start` at once.")

    assert screen.getvalue().splitlines() == [
        "Takes a checkpoint of the model",
        address,
        "and its median-lap.",
        "   a list",
        "Warning: A warning that goes on until a",
        "word has no room.",
        "Error: One [thing] broke.",
        "  Try: Run",
        "`dr-start-training --resume-or-start` at",
        "once.",
    ]


def test_a_next_command_looks_where_this_one_did(working_folder, monkeypatch, capsys):
    monkeypatch.setenv("DR_RUN_ID", "3")
    monkeypatch.setenv("DR_DIR", "/my racer")
    monkeypatch.setenv("DR_LOCAL_S3_BUCKET", "club")
    monkeypatch.setenv("DR_LOCAL_S3_MODEL_PREFIX", "r0")
    monkeypatch.setenv("DR_WORKERS", "2")

    ours = ("dr-status", "DR_RUN_ID=4 dr-status", "DR_EXPERIMENT_NAME=a dr-status")
    terminal.suggest([(command, "look") for command in (*ours, "cp 'a b' c")])

    here = "    DR_DIR='/my racer'"
    assert capsys.readouterr().err.splitlines()[2::2] == [
        f"{here} DR_RUN_ID=3 DR_LOCAL_S3_BUCKET=club DR_LOCAL_S3_MODEL_PREFIX=r0 dr-status",
        f"{here} DR_LOCAL_S3_BUCKET=club DR_LOCAL_S3_MODEL_PREFIX=r0 DR_RUN_ID=4 dr-status",
        f"{here} DR_RUN_ID=3 DR_LOCAL_S3_BUCKET=club DR_EXPERIMENT_NAME=a dr-status",
        "    cp 'a b' c",
    ]


def test_next_commands_have_the_options_that_say_where_this_one_acted(capsys):
    where = {"--region": "eu-west-1", "--profile": None, "--car": "my car"}
    terminal.suggest([("dr-spot list", "look")], options=where)

    assert capsys.readouterr().err.endswith("    dr-spot list --region eu-west-1 --car 'my car'\n")


def test_a_next_command_for_another_place_is_left_as_it_is(working_folder, monkeypatch, capsys):
    monkeypatch.setenv("DR_EXPERIMENT_NAME", "old")

    steps = [("source bin/activate.sh -e new", "go"), ("dr-status", "look")]
    terminal.suggest(steps, elsewhere=True)

    assert "old" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("environment", "live"),
    [
        ({"TERM": "xterm"}, True),
        ({"TERM": "dumb"}, False),
        ({"TERM": "xterm", "NO_COLOR": "1"}, False),
    ],
    ids=["terminal", "TERM=dumb", "NO_COLOR"],
)
def test_a_live_display_wants_a_terminal_that_can_redraw(monkeypatch, environment, live):
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.stdin", Terminal())
    monkeypatch.setattr("sys.stderr", Terminal())
    monkeypatch.setattr(terminal, "err", terminal.Console(stderr=True))

    assert terminal.is_live() is live


def test_a_pipe_is_no_terminal_even_if_colours_are_forced(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr("sys.stdin", Terminal())

    assert not terminal.is_live()


def test_quiet_leaves_warnings_and_failures(monkeypatch, capsys):
    monkeypatch.setattr("drcli.cli.terminal.quiet", True)

    terminal.say("a word")
    terminal.suggest([("dr-status", "look")])
    terminal.warn("odd")
    terminal.fail("It broke.", "Mend it.")

    assert capsys.readouterr().err == "Warning: odd\nError: It broke.\n  Try: Mend it.\n"
