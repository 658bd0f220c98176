"""scripts/spot: the arguments of deepracer-on-the-spot become those of dr-spot."""

import os
import subprocess
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts" / "spot"


@pytest.fixture
def call(tmp_path: Path):
    """Runs a script with a dr-spot that prints its arguments, one a line."""
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "dr-spot").write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    (programs / "dr-spot").chmod(0o755)

    def run(name: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
        variables = {k: v for k, v in os.environ.items() if k != "DR_DIR"}
        return subprocess.run(
            [str(SCRIPTS / name), *arguments],
            cwd=tmp_path,
            env={**variables, "PATH": f"{programs}:{os.environ['PATH']}"},
            capture_output=True,
            text=True,
            timeout=20,
            check=False,
        )

    return run


@pytest.mark.parametrize(
    ("script", "arguments", "expected"),
    [
        ("create-base-resources.sh", "base 203.0.113.7", "create-base base"),
        ("create-base-resources.sh", "base --yes", "create-base base --yes"),
        ("create-spot-instance.sh", "base run 90", "create run --base base --ttl 90"),
        ("create-spot-instance.sh", "base run", "create run --base base --ttl 60"),
        ("create-spot-instance.sh", "base run --yes", "create run --base base --ttl 60 --yes"),
        ("create-spot-instance.sh", "base run 0 -y", "create run --base base --ttl 0 -y"),
        (
            "create-standard-instance.sh",
            "base run 90 --yes",
            "create run --base base --ttl 90 --on-demand --yes",
        ),
        ("stop-training.sh", "run", "stop run"),
        ("add-access.sh", "base run 203.0.113.7", "add-access run 203.0.113.7"),
        (
            "add-interruption-notification-subscription.sh",
            "base run me@example.com",
            "subscribe run me@example.com",
        ),
        (
            "spot-prices.sh",
            "--sort_order SpotPrice --interruption_filter <5%",
            "prices --sort_order SpotPrice --interruption_filter <5%",
        ),
        ("check-instances.sh", "", "list"),
        ("delete-base-resources.sh", "base", "delete base"),
    ],
)
def test_the_arguments_of_the_old_scripts_work(call, script, arguments, expected):
    done = call(script, *arguments.split())

    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == expected.split()


@pytest.mark.parametrize(
    ("script", "arguments"),
    [
        ("create-base-resources.sh", ""),
        ("create-spot-instance.sh", "base"),
        ("create-standard-instance.sh", ""),
        ("stop-training.sh", ""),
        ("add-access.sh", "base run"),
        ("delete-base-resources.sh", ""),
    ],
)
def test_missing_arguments_are_named_and_nothing_is_done(call, script, arguments):
    done = call(script, *arguments.split())

    assert done.returncode == 1
    assert done.stdout == ""
    assert f"Usage: {script}" in done.stderr


def test_files_in_the_old_folder_are_used_where_there_is_no_run_env(call, tmp_path):
    (tmp_path / "custom-files").mkdir()
    (tmp_path / "custom-files" / "run.env").touch()

    assert "--files\ncustom-files" in call("create-spot-instance.sh", "base", "run").stdout

    (tmp_path / "run.env").touch()

    assert "--files" not in call("create-spot-instance.sh", "base", "run").stdout
