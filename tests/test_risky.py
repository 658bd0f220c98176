"""`.ci/risky`: which changes need all tests, seen from a clean clone."""

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / ".ci" / "risky"
UNKNOWN = "Nothing says which commit was tested before."

Git = Callable[..., str]


def git_in(folder: Path) -> Git:
    def git(*arguments: str) -> str:
        who = {f"GIT_{w}_{k}": "me" for w in ("AUTHOR", "COMMITTER") for k in ("NAME", "EMAIL")}
        nothing = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull}
        done = subprocess.run(
            ["git", *arguments],
            cwd=folder,
            env={**os.environ, **who, **nothing},
            check=True,
            capture_output=True,
            text=True,
        )
        return done.stdout.strip()

    return git


def commit(folder: Path, name: str, text: str = "new") -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    git_in(folder)("add", "--all")
    git_in(folder)("commit", "-m", name)


@pytest.fixture
def origin(tmp_path: Path) -> Path:
    """A repository with the script and one commit on main."""
    folder = tmp_path / "origin"
    (folder / ".ci").mkdir(parents=True)
    shutil.copy(SCRIPT, folder / ".ci")
    git_in(folder)("init", "--initial-branch", "main")
    commit(folder, "drcli/train/sim.py", "old")
    return folder


@pytest.fixture
def said(tmp_path: Path) -> Callable[..., str]:
    """What the script says in a clean clone of a repository."""

    def say(origin: Path, **environment: str) -> str:
        clone = tmp_path / "clone"
        shutil.rmtree(clone, ignore_errors=True)
        git_in(tmp_path)("clone", "--quiet", str(origin), str(clone))
        return said_in(clone, **environment)

    return say


def said_in(folder: Path, **environment: str) -> str:
    kept = {name: value for name, value in os.environ.items() if name != "CI_BASE"}
    done = subprocess.run(
        [folder / ".ci" / "risky"],
        env={**kept, **environment},
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stderr == ""
    return done.stdout.strip()


@pytest.mark.nightly
def test_without_anything_to_compare_with_all_tests_run(origin, said):
    assert said(origin) == UNKNOWN
    assert said(origin, CI_BASE="nothing") == UNKNOWN


@pytest.mark.nightly
def test_a_branch_is_compared_with_where_it_left_main(origin, tmp_path):
    clone = tmp_path / "clone"
    git_in(tmp_path)("clone", "--quiet", str(origin), str(clone))
    start = git_in(clone)("rev-parse", "--short=9", "HEAD")
    git_in(clone)("switch", "--quiet", "--create", "work")

    commit(clone, "docs/page.md")
    assert said_in(clone) == ""

    commit(clone, "drcli/train/sim.py")
    commit(clone, "docs/other.md")
    assert said_in(clone) == f"drcli/train/sim.py has changed since {start}."


@pytest.mark.nightly
def test_on_main_a_merge_is_compared_with_its_other_side(origin, said):
    git = git_in(origin)
    git("switch", "--quiet", "--create", "work")
    commit(origin, "drcli/cli/view.py")
    git("switch", "--quiet", "main")
    commit(origin, "drcli/train/sim.py")
    git("merge", "--no-ff", "work")

    assert said(origin) == ""


@pytest.mark.nightly
def test_on_main_commits_are_compared_with_the_last_tag_before_them(origin, said):
    git_in(origin)("tag", "v1")
    commit(origin, "docs/page.md")
    git_in(origin)("tag", "v2")

    assert said(origin) == ""

    commit(origin, "drcli/train/sim.py")
    assert said(origin) == "drcli/train/sim.py has changed since v2."


@pytest.mark.nightly
def test_a_commit_that_was_named_or_has_passed_all_tests_comes_first(origin, said, tmp_path):
    git_in(origin)("tag", "v1")
    commit(origin, "drcli/train/sim.py")
    before = git_in(origin)("rev-parse", "HEAD")
    commit(origin, "docs/page.md")

    assert said(origin, CI_BASE=before) == ""

    clone = tmp_path / "clone"
    assert "sim.py has changed" in said_in(clone)
    git_in(clone)("update-ref", "refs/ci/all", before)
    assert said_in(clone) == ""


@pytest.mark.nightly
@pytest.mark.parametrize("path", ["constraints/dev.txt", "a-new-package/module.py"])
def test_what_is_not_committed_counts_and_what_nobody_has_thought_of_is_risky(origin, path):
    git_in(origin)("update-ref", "refs/ci/all", "HEAD")
    (origin / path).parent.mkdir()
    (origin / path).touch()

    assert said_in(origin).startswith(f"{path} has changed")


@pytest.mark.nightly
@pytest.mark.parametrize(("text", "risky"), [("mark.nightly", True), ("mark.skip", False)])
def test_a_test_is_risky_where_commits_leave_it_out(origin, text, risky):
    git_in(origin)("update-ref", "refs/ci/all", "HEAD")
    commit(origin, "tests/drcli/test_it.py", f"@pytest.{text}")

    assert bool(said_in(origin)) == risky


def test_every_harmless_kind_is_there():
    lines = SCRIPT.read_text().partition("harmless=(\n")[2].partition("\n)")[0]

    kinds = [kind.strip("'") for kind in lines.split()]

    assert len(kinds) > 10
    assert [kind for kind in kinds if not list(ROOT.glob(kind))] == []
