"""docs/requirements.md names all 125 numbers, with commands, pages and tests that exist."""

import re
from pathlib import Path

import pytest

from drcli.config.settings import catalogue
from written_commands import problem_of

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "requirements.md"

COUNTS = {"000": 26, "001": 53, "002": 17, "003": 20, "004": 9}
"""How many things each document asks for."""

ROW = re.compile(r"^\| (\d{3}-\d\d) \| (.+?) \| (.+?) \| \[(.+?)\]\((.+?)\) \| `(.+?)` \|$")

COMING = {
    *("stops.md", "sac.md", "checkpoints.md", "bench.md", "training-trouble.md", "evaluation.md"),
    *("ready-made-models.md", "sim-to-real.md"),
    *("dr-note", "dr-bench", "dr-tidy", "dr-list-checkpoints", "dr-action-space"),
    *("DR_TRAIN_STOP_MEAN_SCORE", "DR_TRAIN_MAX_EPISODES", "DR_REWARD_ON_ERROR"),
    *("DR_TRAIN_KEEP_MILESTONES", "DR_TRAIN_MAX_ROLLBACKS", "DR_PRIORITY", "DR_THREADS"),
    *("DR_EVAL_AVERAGE_LAPS", "DR_EVAL_MAX_LAP_SECONDS", "DR_SIM_GLARE", "DR_SIM_REFLECTIONS"),
    *("DR_SIM_BATTERY", "--preset", "--model", "--loop", "--robust"),
    *("--world", "--reward", "--description"),
    "tests/drcli/workers/test_reward_failures.py",
    "tests/drcli/workers/test_roll_back.py",
    "tests/drcli/store/test_alarms.py",
    "tests/drcli/store/test_milestones.py",
    "tests/drcli/models/test_checkpoint_choice.py",
    "tests/drcli/base/test_low_priority.py",
    "tests/drcli/config/new_folder/test_presets.py",
    "tests/drcli/rewards/test_example_rewards.py",
    "tests/drcli/modelfiles/test_action_choice.py",
    "tests/drsim/episode/test_start_poses.py",
    "tests/drsim/sensing/test_lamps.py",
}
"""Parts that are built at the same time as this page; a name leaves when its part is here."""


def rows() -> list[tuple[str, ...]]:
    """Number, request, commands and settings, title, page and test of each row."""
    lines = PAGE.read_text("utf-8").splitlines()
    return [match.groups() for line in lines if (match := ROW.match(line))]


def test_every_number_is_there_once_and_in_order():
    wanted = [f"{doc}-{k:02}" for doc, count in COUNTS.items() for k in range(1, count + 1)]

    assert len(wanted) == 125
    assert [row[0] for row in rows()] == wanted


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0])
def test_what_a_row_names_exists(row):
    _, _, how, _, page, test = row

    assert (ROOT / "docs" / page).is_file() or page in COMING, page
    assert (ROOT / test).is_file() or test in COMING, test
    for code in re.findall(r"`([^`]+)`", how):
        if code.startswith("DR_"):
            assert code in catalogue() or code in COMING, code
        elif code.startswith(("dr-", "droa-")) and code.split()[0] not in COMING:
            problem = problem_of(code.replace("...", "x"))
            assert not problem or problem.split()[-1] in COMING, problem
        elif code.startswith(("python scripts/", "scripts/")):
            assert (ROOT / code.removeprefix("python ").split()[0]).exists(), code
