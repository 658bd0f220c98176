"""`dr spot watch`."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from types import FrameType
from typing import Annotated

import typer

from drcli.base.errors import Absent, SettingsError
from drcli.base.processes import STOPS, handle, is_alive, restore, started_s
from drcli.cli import terminal
from drcli.clouds.cloud import Notice
from drcli.clouds.registry import CLOUDS, cloud_of_machine
from drcli.outside.notices.notice_watch import Announced, NoticeWatch, command_words, soonest
from drcli.run.interruption_watch import MARGIN_S, SAVE_S, due
from drcli.run.outcome import INTERRUPTED

# Watches for the notice on behalf of another program, and ends it in time.


POLL_S = 0.2

_CLOUDS = ("auto", *CLOUDS)
TERM_GRACE_S = 30.0
"""Of Kubernetes and Slurm before SIGKILL."""

NOT_FOUND, NOT_EXECUTABLE = 127, 126


@dataclass(frozen=True)
class WatchReport:
    """The result of `dr-spot watch`."""

    source: Annotated[str | None, "aws, gcp, azure, command or signal; null without a notice."]
    kind: Annotated[str | None, "interruption or rebalance."]
    action: Annotated[str | None, "What happens to the machine."]
    seconds_left: Annotated[float | None, "Until then; null if unknown."]
    text: Annotated[str, "A sentence."]
    exit_code: Annotated[int, "Of this command."]

    @staticmethod
    def of(notice: Notice, exit_code: int, left_s: float | None = None) -> "WatchReport":
        """The report of a notice; `left_s` is what is left of its time."""
        left_s = notice.seconds_left if left_s is None else left_s
        return WatchReport(
            notice.source, notice.kind, notice.action, left_s, notice.text, exit_code
        )


@dataclass(frozen=True)
class NoticeHandling:
    """What happens at the notice: `number` is the signal for the program.

    `wait_s`: how long it may take to exit; None for what the notice leaves.
    """

    number: signal.Signals = signal.SIGTERM
    on_notice: tuple[str, ...] = ()
    wait_s: float | None = None
    on_rebalance: bool = False


class ForeignWatch:
    """Waits for a notice or for the end of a program.

    SIGTERM, which schedulers send, and SIGHUP are notices too.
    """

    def __init__(self, watch: NoticeWatch, handling: NoticeHandling) -> None:
        self._watch = watch
        self._handling = handling
        self._terminated: signal.Signals | None = None

    def run(self, command: Sequence[str]) -> WatchReport:
        # Ctrl-C goes to the command as well, and its exit code says what became of it.
        before = {
            **handle(self._note_signal, STOPS),
            **handle(lambda *_: None, (signal.SIGINT,)),
        }
        try:
            # The handlers above are not inherited, because exec resets them.
            with subprocess.Popen(list(command)) as process:
                found = self._await(lambda: process.poll() is not None)
                if found is None:
                    return _ended(command[0], process.returncode)
                report = self._act(found, process.pid, lambda: process.poll() is not None)
                if process.poll() is None:
                    process.kill()
                return report
        except FileNotFoundError:
            return WatchReport(None, None, None, None, f"{command[0]} is not found.", NOT_FOUND)
        except OSError as error:
            text = f"{command[0]} cannot be started: {error.strerror or error}."
            return WatchReport(None, None, None, None, text, NOT_EXECUTABLE)
        finally:
            self._watch.stop()
            restore(before)

    def follow(self, pid: int) -> WatchReport:
        """Watch a running process; Absent if there is none."""
        began_s = started_s(pid)
        if began_s is None:
            raise Absent(f"No process {pid} runs here.", remedy="Look for it with `ps aux`.")
        before = handle(self._note_signal, STOPS)

        def has_ended() -> bool:
            return not is_alive(pid, began_s)

        try:
            found = self._await(has_ended)
            if found is None:
                return WatchReport(None, None, None, None, f"Process {pid} has ended.", 0)
            return self._act(found, pid, has_ended)
        finally:
            self._watch.stop()
            restore(before)

    def wait(self) -> WatchReport:
        try:
            found = self._await(lambda: False)
            assert found is not None
            self._run_on_notice(found)
            return WatchReport.of(found.notice, 0, found.left_s(time.monotonic()))
        finally:
            self._watch.stop()

    def once(self) -> WatchReport:
        """Exit code 1 without a notice; MetadataSilent if nobody answers."""
        announced = self._watch.ask_once()
        found = soonest(announced, time.monotonic())
        if found is None:
            found = next(iter(announced), None)
        if found is None:
            return WatchReport(None, None, None, None, "There is no notice.", 1)
        return WatchReport.of(found.notice, 0)

    def _note_signal(self, number: int, _frame: FrameType | None) -> None:
        self._terminated = signal.Signals(number)

    def _await(self, has_ended: Callable[[], bool]) -> Announced | None:
        self._watch.start()
        while not has_ended():
            now_s = time.monotonic()
            if self._terminated is not None:
                text = f"{self._terminated.name} came."
                notice = Notice("signal", "interruption", "terminate", TERM_GRACE_S, text)
                return Announced(notice, now_s)
            announced = self._watch.announced()
            found = due(announced, now_s, on_rebalance=self._handling.on_rebalance)
            if found is not None:
                return found
            time.sleep(POLL_S)
        return None

    def _act(self, found: Announced, pid: int, has_ended: Callable[[], bool]) -> WatchReport:
        with suppress(ProcessLookupError, PermissionError):
            os.kill(pid, self._handling.number)
        left_s = found.left_s(time.monotonic())
        wait_s = self._handling.wait_s
        if wait_s is None:
            wait_s = SAVE_S if left_s is None else max(MARGIN_S, left_s - MARGIN_S)
        deadline_s = time.monotonic() + wait_s
        other = self._run_on_notice(found)
        while time.monotonic() < deadline_s:
            if has_ended() and (other is None or other.poll() is not None):
                break
            time.sleep(POLL_S)
        return WatchReport.of(found.notice, INTERRUPTED, found.left_s(time.monotonic()))

    def _run_on_notice(self, found: Announced) -> "subprocess.Popen[bytes] | None":
        command = self._handling.on_notice
        if not command:
            return None
        left_s = found.left_s(time.monotonic())
        notice = found.notice
        about = {
            "DR_NOTICE_SOURCE": notice.source,
            "DR_NOTICE_ACTION": notice.action,
            "DR_NOTICE_SECONDS_LEFT": "" if left_s is None else f"{left_s:.0f}",
            "DR_NOTICE_TEXT": notice.text,
        }
        try:
            return subprocess.Popen(list(command), env={**os.environ, **about})
        except OSError as error:
            sys.stderr.write(f"{command[0]} cannot be started: {error.strerror or error}.\n")
            return None


def signal_named(text: str) -> signal.Signals:
    """A signal such as USR1, SIGUSR1 or 10; SettingsError if there is none."""
    word = text.strip().upper()
    try:
        if word.isdigit():
            return signal.Signals(int(word))
        return signal.Signals[word if word.startswith("SIG") else f"SIG{word}"]
    except (ValueError, KeyError):
        raise SettingsError(
            f"{text!r} is not a signal.", remedy="Name one as in --signal USR1, or --signal 10."
        ) from None


def _ended(name: str, code: int) -> WatchReport:
    shown = 128 - code if code < 0 else code
    return WatchReport(None, None, None, None, f"{name} ended with exit code {shown}.", shown)


def _known_cloud(name: str) -> str:
    if name not in _CLOUDS:
        raise typer.BadParameter(f"{name!r} is not one of {', '.join(map(repr, _CLOUDS))}.")
    return name


def watch(
    command: Annotated[
        list[str] | None,
        typer.Argument(metavar="-- COMMAND ...", help="Program to run, with its arguments."),
    ] = None,
    pid: Annotated[
        int | None, typer.Option("--pid", min=1, metavar="N", help="Watch for this process.")
    ] = None,
    on_notice: Annotated[
        str | None,
        typer.Option("--on-notice", metavar="CMD", help="Program to run when the notice comes."),
    ] = None,
    number: Annotated[
        str, typer.Option("--signal", metavar="S", help="Signal that the program gets then.")
    ] = "TERM",
    wait_s: Annotated[
        float | None,
        typer.Option(
            "--wait",
            min=0,
            max=86_400,
            metavar="SECONDS",
            help="How long the program may take to exit; without it, as long as the notice leaves.",
        ),
    ] = None,
    rebalance: Annotated[
        bool,
        typer.Option("--rebalance", help="A recommendation to move counts as a notice too."),
    ] = False,
    once: Annotated[
        bool, typer.Option("--once", help="Ask once, and exit 1 if there is no notice.")
    ] = False,
    cloud: Annotated[
        str,
        typer.Option(
            "--cloud",
            metavar=f"[{'|'.join(_CLOUDS)}]",
            callback=_known_cloud,
            help="Whose metadata service to ask.",
        ),
    ] = "auto",
    hook: Annotated[
        str,
        typer.Option(
            "--hook", metavar="CMD", help="Program that exits 0 when the machine goes away."
        ),
    ] = "",
) -> None:
    """Watch for the notice that this machine will be taken away, for a program other than drcli.

    Runs the program, or watches for a running one. On notice, the program gets a signal and time to
    exit, and this command exits 75. Otherwise it has the exit code of the program. Without a
    program, it waits for the notice, prints it and exits 0. SIGTERM counts as a notice.

    Example: dr-spot watch --on-notice ./save.sh -- python train.py
    """
    if command and pid is not None:
        raise typer.BadParameter("Give a program or --pid, not both.")
    if command and not command[0]:
        raise typer.BadParameter("The name of the program is empty.")
    if once and (command or pid is not None):
        raise typer.BadParameter("--once asks for the notice only: leave out the program.")
    handling = NoticeHandling(
        signal_named(number),
        tuple(command_words(on_notice or "", "--on-notice")),
        wait_s,
        rebalance,
    )
    words = command_words(hook, "--hook")
    found = cloud_of_machine(os.environ) if cloud == "auto" else cloud
    address = os.environ.get("DR_METADATA_SERVICE_URL", "")
    source = None if found is None else CLOUDS[found].source(os.environ, address)
    if source is None and not words:
        what = "This machine belongs to no cloud whose notices could be read."
        if not command and pid is None:
            remedy = "Name the cloud with --cloud, or a program of yours with --hook."
            raise SettingsError(what, remedy=remedy)
        terminal.warn(f"{what} Only SIGTERM is watched for.")
    watching = ForeignWatch(NoticeWatch(source, words), handling)
    if once:
        report = watching.once()
    elif command:
        report = watching.run(command)
    elif pid is not None:
        report = watching.follow(pid)
    else:
        report = watching.wait()
    if command or pid is not None:
        terminal.say(report.text)
        terminal.emit(report, None)
    else:
        terminal.emit(report, report.text)
    raise typer.Exit(report.exit_code)
