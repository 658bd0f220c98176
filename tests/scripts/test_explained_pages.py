"""Pages that show the texts of `dr-explain`; known error texts are found there (001-53)."""

import re
from pathlib import Path

import explained_pages
import pytest

from drcli.checks.explain.lookup import explain
from drcli.rewards.reward_parameter_texts import REWARD_PARAMETERS

DOCS = Path(__file__).resolve().parents[2] / "docs"

LITERAL_TEXTS = (
    "Found a lock file",  # 001-30
    "Received termination signal from trainer. Goodbye.",  # 001-31
    "Unable to finish 1 lap",  # 001-47
    "NaN detected in loss function, aborting training.",  # 001-32
    "Sagemaker is not running.",  # 001-14, 001-15
    "is not running.",
    "Reward function error:",  # 001-17
    "Failed to import user's reward_function:",
    "No model files found. Files possibly deleted. Try again.",  # 001-48
    "Meta-data files are not found. Exiting.",
    "No upload bucket defined. Exiting.",
    "No upload prefix defined. Exiting.",
    "Target equals source. Exiting.",
    "No source URL to download model from.",
    "No target prefix defined. Exiting.",
    "Training aborted. Configuration files were not found.",
    "exists. Delete it, or use -w option. Exiting.",
    "Stop training with dr-stop-training.",
    "ERROR: AWS credentials not found in profile",
    "File system.env does not exist.",
    "No X Server running on display",
    "No XAUTHORITY defined",
    "ERROR: No Swarm Nodes labelled",
    "Swarm exists. Exiting.",
    "No running robomakers. Exiting.",
    "Exited main loop. Done.",
    "FAULT_CODE",
    "simapp_exception",
    "Invalid option",
    "Invalid input head",
    "Invalid servo request",
    "EC2 Spot Instance Interruption Warning",
    "Model uploaded successfully to your vehicle",
    "Cannot cut empty array",
    "but action_space has",  # V-35, 001-33
)
"""As other programs print them, and as racers paste them into a search."""


@pytest.mark.parametrize("name", ["glossary", "hyperparameters", "troubleshooting"])
def test_a_page_in_docs_is_what_the_texts_say(name):
    written = (DOCS / f"{name}.md").read_text("utf-8")

    assert written == getattr(explained_pages, name)(), "Run `python scripts/docs`."


@pytest.mark.parametrize("text", LITERAL_TEXTS)
def test_a_known_error_text_is_on_the_page_and_has_an_answer(text):
    page = (DOCS / "troubleshooting.md").read_text("utf-8")

    assert text in page
    if text not in ("is not running.", "simapp_exception"):
        assert "error text" in [entry.kind for entry in explain(text)]


def test_the_page_of_reward_functions_says_what_dr_explain_says():
    page = (DOCS / "reward-functions.md").read_text("utf-8")

    for name, text in REWARD_PARAMETERS.items():
        row = next(line for line in page.splitlines() if re.match(rf"\| .*`{name}`", line))
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert cells[1:] == [text.kind, text.unit, text.meaning], name
