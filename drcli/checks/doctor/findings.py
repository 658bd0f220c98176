"""Findings: what was examined, whether it is right, and what to do."""

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from drcli.base.errors import DrError, SettingsError, StorageError
from drcli.base.report import Log, Styled, View, bold, counted, dim

State = Literal["ok", "warning", "problem"]
"""A problem prevents or harms a training; a warning may."""

AT_BUCKET = ("bucket", "upload bucket")


@dataclass(frozen=True)
class Finding:
    """One thing that was examined."""

    subject: Annotated[str, "What it is about, in a word or two."]
    state: Annotated[State, "`ok`, `warning` or `problem`."]
    text: Annotated[str, "What was found."]
    remedy: Annotated[str, "What to do, starting with a verb; empty if there is nothing to do."] = (
        ""
    )
    facts: Annotated[
        Mapping[str, Any], "The same for programs; which keys there are depends on the subject."
    ] = field(default_factory=dict)

    def pieces(self) -> tuple[object, ...]:
        styles = {"ok": "green", "warning": "yellow", "problem": "bold red"}
        remedy = bold(f"\nTry: {self.remedy}") if self.remedy else ""
        return Styled(self.state, styles[self.state]), dim(self.subject), (self.text, remedy)


@dataclass(frozen=True)
class DoctorReport:
    """What `dr doctor` found."""

    folder: Annotated[str, "The working folder."]
    seconds: Annotated[float, "How long it took."]
    findings: Annotated[
        tuple[Finding, ...], "Everything that was examined, in the order of the page."
    ]

    @property
    def problems(self) -> int:
        """Number of problems."""
        return sum(finding.state == "problem" for finding in self.findings)

    @property
    def warnings(self) -> int:
        """Number of warnings."""
        return sum(finding.state == "warning" for finding in self.findings)

    @property
    def exit_code(self) -> int:
        """0 without problems, 4 if only a bucket has problems, otherwise 3."""
        wrong = {finding.subject for finding in self.findings if finding.state == "problem"}
        if not wrong:
            return 0
        return StorageError.code if wrong <= set(AT_BUCKET) else SettingsError.code

    def view(self) -> View:
        problems = counted(self.problems, "problem") if self.problems else "No problems"
        warnings = counted(self.warnings, "warning")
        return [
            bold(self.folder),
            Log([finding.pieces() for finding in self.findings]),
            f"{problems}, {warnings}, in {self.seconds:.1f} s.",
        ]


@dataclass(frozen=True)
class Probe:
    subject: str
    examine: Callable[[], Iterable[Finding]]


class Examination:
    """Runs probes in threads, which start at once."""

    def __init__(self, probes: Sequence[Probe]) -> None:
        self._probes = probes
        self._found: list[list[Finding]] = [[] for _ in probes]
        self._began_s = time.monotonic()
        self._threads = [
            threading.Thread(target=self._examine, args=pair, name=pair[0].subject, daemon=True)
            for pair in zip(probes, self._found, strict=True)
        ]
        for thread in self._threads:
            thread.start()

    def wait(self, seconds: float) -> None:
        deadline_s = time.monotonic() + seconds
        for thread in self._threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))

    def findings(self) -> list[Finding]:
        """Until now, with a warning about each probe that has not ended."""
        everything: list[Finding] = []
        for probe, found, thread in zip(self._probes, self._found, self._threads, strict=True):
            late = thread.is_alive()
            everything += list(found)
            if late:
                waited_s = time.monotonic() - self._began_s
                everything.append(
                    Finding(
                        probe.subject,
                        "warning",
                        f"the examination was not finished after {waited_s:.0f} s.",
                        "Run it again; if this stays, a disk, a network or a program hangs.",
                    )
                )
        return everything

    def _examine(self, probe: Probe, found: list[Finding]) -> None:
        try:
            found.extend(probe.examine())  # what comes before a failure is kept
        except DrError as error:
            found.append(Finding(probe.subject, "problem", str(error), error.remedy))
        except Exception as error:  # an odd machine must not keep the rest from being examined
            why = f"{type(error).__name__}: {error}"
            found.append(Finding(probe.subject, "warning", f"it could not be examined ({why})."))


def shown_bytes(size: float) -> str:
    """Such as `61 GB`."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size / 1e3:.3g} kB"
