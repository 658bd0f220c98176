"""Hand-written guides: commands exist, links lead somewhere (003-13, 003-17, 004-08)."""

import ast
import json
import re
from pathlib import Path

import pytest
import yaml
from check_wheels import PYTHONS, SYSTEMS

from written_commands import problem_of

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
NOTEBOOK = DOCS / "notebooks" / "train_in_colab.ipynb"

GUIDES = [
    *("car-guide.md", "platforms.md", "lessons/README.md", "course-project.md"),
    *("glossary.md", "hyperparameters.md"),
]

REVIEWED = ROOT / "tests" / "data" / "reviewed_denials.txt"
"""Sentences that deny something and were looked at: `page: sentence`."""

GENERATED = ("commands.md", "settings.md", "errors.md")

DENIAL = re.compile(
    r"(?:^|\|)(?:(?!\||\b(?:if|where|whether|that|what|which|who|although|because|when|so)\b).)*"
    r"\b(?:cannot|can not|not (?:available|needed|possible|supported|implemented)|only there"
    r"|there (?:is|are) no(?:ne)?|not .*\byet)\b",
    re.IGNORECASE,
)

WORKFLOW = ROOT / ".github" / "workflows" / "tests.yml"


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.casefold()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("name", [*GUIDES, *(f"lessons/{p.name}" for p in DOCS.glob("lessons/*"))])
def test_links_of_a_guide_lead_to_pages_and_headings(name):
    page = DOCS / name
    text = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), target


@pytest.mark.parametrize("name", GUIDES[:4])
def test_commands_of_a_guide_exist_with_their_options(name):
    text = (DOCS / name).read_text("utf-8")
    blocks = re.findall(r"```\w*\n(.*?)```", text, re.DOTALL)
    lines = [line.strip() for block in blocks for line in block.splitlines()]
    lines += [
        code for code in re.findall(r"`([^`\n]+)`", text) if code.startswith(("dr-", "droa-"))
    ]

    assert [(line, problem) for line in lines if (problem := problem_of(line))] == []


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("dr-evaluate --jsn", "there is no option --jsn"),
        ("dr-reward chek", "reward has no command chek"),
        ("dr-evaluat", "dr-evaluat is not a program"),
        ("dr nothing", "nothing is not a command"),
        ("DR_WORLD_NAME=bean dr-evaluate -q --json  # says more", ""),
        ("git clone <this project>", ""),
    ],
)
def test_the_check_of_command_lines_finds_what_is_wrong(line, problem):
    assert problem_of(line) == problem


def claims(page: Path) -> list[str]:
    """The sentences of a page that deny something, without conditions such as "if there is no"."""
    text = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    blocks = re.split(r"\n\s*\n|\n(?=[-*#|] |\d+\. )", text)
    sentences = [
        sentence
        for block in blocks
        for sentence in re.split(r"(?<=[.:;!?])\s+", " ".join(block.split()))
    ]
    return [sentence for sentence in sentences if DENIAL.search(sentence)]


def test_what_the_pages_deny_was_reviewed():
    """The product grows: what it could not do in one month it does in the next.

    A sentence that fails here is new. Look whether a command or a setting does what it denies; if
    really none does, add the sentence to the list.
    """
    reviewed = set(REVIEWED.read_text("utf-8").splitlines())
    pages = [page for page in DOCS.rglob("*.md") if page.name not in GENERATED]

    found = {f"{page.relative_to(DOCS)}: {each}" for page in pages for each in claims(page)}

    assert not found - reviewed, "\n".join(["New lines to review:", *sorted(found - reviewed)])
    assert not reviewed - found, "\n".join(["Lines to remove:", *sorted(reviewed - found)])


def test_no_page_denies_a_command_that_exists():
    name = r"`(dr[a-z]*[- ][a-z-]+)"
    state = r"(?:available|exist|implemented|supported|possible)"
    denied = re.compile(
        rf"{name}[^`]*` (?:is|are|does|do) not {state}|[Tt]here is no (?:command )?{name}"
    )
    named = [
        (page.name, name)
        for page in DOCS.rglob("*.md")
        for match in denied.finditer(" ".join(page.read_text("utf-8").split()))
        for name in match.groups()
        if name and not problem_of(name)
    ]

    assert named == []


def test_the_car_guide_has_all_its_subjects():
    text = (DOCS / "car-guide.md").read_text("utf-8").casefold()

    for subject in (
        *("calibrat", "model that the car brings", "below 10 %", "barrier", "reflection"),
        *("wrong measures", "throttle parity", "camera view", "left border", "direction"),
    ):
        assert subject in text


def cells(kind: str) -> list[str]:
    """Sources of the notebook's cells."""
    content = json.loads(NOTEBOOK.read_text("utf-8"))
    return ["".join(cell["source"]) for cell in content["cells"] if cell["cell_type"] == kind]


def test_the_notebook_has_the_form_of_version_4():
    content = json.loads(NOTEBOOK.read_text("utf-8"))

    assert (content["nbformat"], content["nbformat_minor"]) == (4, 5)
    assert content["metadata"]["kernelspec"]["name"] == "python3"
    names = [cell["id"] for cell in content["cells"]]
    assert len(set(names)) == len(names)
    for cell in content["cells"]:
        assert re.fullmatch(r"[a-zA-Z0-9_-]{1,64}", cell["id"])
        assert cell["metadata"] == {}
        assert all(isinstance(line, str) for line in cell["source"])
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)


def test_the_cells_of_the_notebook_call_commands_that_exist():
    source = "\n".join(cells("code"))
    given = dict(re.findall(r"^([A-Z]+) = (\S+)", source, re.MULTILINE))
    called = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "run":
            text = ast.unparse(node.args[0]).removeprefix("f").strip("'\"")
            called.append(re.sub(r"\{(\w+)\}", lambda m: given.get(m[1], "x").strip('"'), text))

    words = {line.split()[0] for line in called}
    assert {"dr-init", "dr-start-training", "dr-evaluate", "dr-export", "dr-tracks"} <= words
    assert [(line, problem) for line in called if (problem := problem_of(line))] == []


def test_the_matrix_of_the_workflow_has_every_supported_system_and_python():
    jobs = yaml.safe_load(WORKFLOW.read_text("utf-8"))["jobs"]
    matrix = jobs["tests"]["strategy"]["matrix"]

    assert matrix["python"] == list(PYTHONS)
    assert {name.split("-")[0] for name in matrix["os"]} == {"ubuntu", "macos"}
    assert any(name.endswith("-arm") for name in matrix["os"])
    assert "wsl" in jobs
    for job in jobs.values():
        for step in job["steps"]:
            for script in re.findall(r"scripts/[\w./]+", step.get("run", "")):
                assert (ROOT / script).exists()


def test_the_page_of_platforms_promises_what_the_check_of_wheels_demands():
    rows = (DOCS / "platforms.md").read_text("utf-8").splitlines()

    def row(*words: str) -> str:
        return next(r for r in rows if r.startswith("|") and all(w in r for w in words))

    assert "complete" in row("Linux, x86_64 |")
    assert "complete" in row("aarch64")
    assert "complete" in row("Apple silicon")
    assert "not possible" in row("Intel")
    assert [name for name, system in SYSTEMS.items() if not system.supported] == ["macOS x86_64"]
