"""What the check of wheels for other systems makes of the answers of uv (001-06)."""

from pathlib import Path

import check_wheels
import pytest


def fake_uv(folder: Path, text: str, code: int) -> str:
    """A program that answers like uv."""
    program = folder / "uv"
    program.write_text(f"#!/bin/sh\ncat >&2 <<'END'\n{text}\nEND\nexit {code}\n")
    program.chmod(0o755)
    return str(program)


def test_what_is_missing_is_one_line_with_the_reason(tmp_path):
    uv = fake_uv(
        tmp_path,
        "  × No solution found when resolving dependencies:\n"
        "  ╰─▶ Because torch==2.13.0 has no wheels with a\n      matching platform tag.\n"
        "  hint: Wheels are available",
        1,
    )

    found = check_wheels.missing_wheels(uv, check_wheels.SYSTEMS["macOS x86_64"], "3.12")

    assert found == "Because torch==2.13.0 has no wheels with a matching platform tag."


def test_a_complete_system_misses_nothing(tmp_path):
    uv = fake_uv(tmp_path, "", 0)

    assert check_wheels.missing_wheels(uv, check_wheels.SYSTEMS["macOS arm64"], "3.11") == ""


def test_an_index_that_does_not_answer_is_no_missing_wheel(tmp_path):
    uv = fake_uv(tmp_path, "error: Failed to fetch: `https://pypi.org/simple/torch/`", 2)

    with pytest.raises(check_wheels.NoIndex):
        check_wheels.missing_wheels(uv, check_wheels.SYSTEMS["Linux x86_64"], "3.11")
