"""A reward function that harms the process it is tried in is told as a finding."""

import os

import pytest

from drcli.config import load_settings
from drcli.job import Job
from drcli.runs.inputs import InputFile
from drcli.validate.trial import try_inputs


@pytest.fixture
def tried(folder, tmp_path):
    """What is found about a reward function, in a process as when a training starts."""
    settings = load_settings(folder.path, environ={})
    job = Job(settings, folder.path, "abc", 0, None, None, tmp_path / "trial", os.getpid())

    def find(before: str, body: str):
        code = f"{before}\n\n\ndef reward_function(params):\n    {body}\n"
        return try_inputs(job, InputFile("reward_function.py", code.encode(), "mine.py"))

    return find


@pytest.mark.parametrize(
    ("before", "body", "words"),
    [
        ("import os", "os._exit(0)", "ended the process that tried it (exit code 0)"),
        ("import os", "os.killpg(0, 15)", "ended the process that tried it (exit code -15)"),
        ("", "raise KeyboardInterrupt", "breaks the process that tried it: KeyboardInterrupt"),
        ("import builtins; builtins.len = None", "return 1.0", "breaks the process that tried it:"),
    ],
)
def test_code_that_ends_or_breaks_its_process_is_named(tried, before, body, words):
    [found] = tried(before, body)

    assert (found.rule, found.where) == ("V-21", "mine.py")
    assert words in found.message


@pytest.mark.parametrize(
    ("before", "body"),
    [
        ("import os", "return float(os.fork() > 0)"),
        ("import os; os.fork()", "return 1.0"),
        ("import os, sys; sys.stderr.close(); os.close(2)", "return 1.0"),
        ("import sys", "return float(sys.stderr.write('x' * 100_000) > 0)"),
    ],
)
def test_code_that_forks_or_floods_holds_nothing_up(tried, before, body):
    assert tried(before, body) == []


def test_files_of_the_working_folder_are_no_modules(tried, folder):
    (folder.path / "json.py").write_text("raise RuntimeError\n")

    assert tried("import json", "return float(json.loads('1'))") == []
