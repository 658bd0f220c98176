"""Reads a lesson from its page: the files that the reader writes, and the commands that he runs."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs" / "lessons"

LESSONS: Mapping[int, Path] = {
    int(path.name.split("-")[0]): path for path in sorted(DOCS.glob("[1-9]-*.md"))
}
"""The pages by number."""

REPORTS = ("dr-reward check", "dr-reward plot", "dr-evaluate", "dr-status", "dr-start-training")
"""Commands whose report the runner keeps."""

_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_INTO = re.compile(r"into\s+`([^`]+)`:?\s*$")


@dataclass(frozen=True)
class Step:
    """A block of a page.

    Attributes:
        file: Where the reader writes it; empty for commands.
        text: Its lines.
    """

    file: str
    text: str


@dataclass(frozen=True)
class Lesson:
    """A page.

    Attributes:
        number: The one that its name begins with.
        text: The whole page.
        steps: Its blocks, in order.
    """

    number: int
    text: str
    steps: tuple[Step, ...]

    @staticmethod
    def read(path: Path) -> "Lesson":
        """Read a page."""
        text = path.read_text("utf-8")
        return Lesson(int(path.name.split("-")[0]), text, tuple(_steps(text)))

    @property
    def commands(self) -> list[str]:
        """Every command line of the page."""
        lines = [line for step in self.steps if not step.file for line in step.text.splitlines()]
        return [line for line in lines if line and not line.startswith("#")]

    @property
    def files(self) -> dict[str, str]:
        """What the reader writes, by file; the last block if there are several for one."""
        return {step.file: step.text for step in self.steps if step.file}

    def script(self) -> str:
        """A bash script that does what the page says, and keeps the reports in `$RESULTS`."""
        lines = ["set -e -o pipefail"]
        if self.number > 1:
            lines.append("cd racer")
        count = 0
        for step in self.steps:
            if step.file:
                lines += [f"cat >{step.file} <<'END-OF-FILE'", step.text.rstrip(), "END-OF-FILE"]
                continue
            for line in step.text.splitlines():
                command = line.split("#")[0].rstrip()
                if any(report in command for report in REPORTS):
                    count += 1
                    name = next(report for report in REPORTS if report in command)
                    file = f"{count:02}-{name.replace(' ', '-')}"
                    command = f'{command} --json | tee "$RESULTS/{file}"'
                lines.append(command)
        return "\n".join(lines) + "\n"


def _steps(text: str) -> Iterator[Step]:
    for match in _BLOCK.finditer(text):
        into = _INTO.search(text[: match.start()].rstrip())
        if into:
            yield Step(into[1], match[2])
        elif match[1] == "sh":
            yield Step("", match[2])
