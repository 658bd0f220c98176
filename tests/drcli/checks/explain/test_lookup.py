"""`dr-explain` finds words however they are written (001-45, 001-53, 002-10, 003-07)."""

import re
import typing
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drcli
from drcli.analysis.findings import verdict
from drcli.base.errors import SettingsError
from drcli.checks.explain.explain_texts import EXIT_CODES, GLOSSARY, TRACE_COLUMNS
from drcli.checks.explain.lookup import Explanation, every_entry, explain, shipped_values
from drcli.config.settings import catalogue
from drcli.config.value_types import CheckpointWord
from drcli.model.files.hyperparameters import KEYS, TEXTS
from drcli.model.files.model_metadata import Network
from drcli.model.files.sensors import SENSORS
from drcli.records.trace import CSV_HEADER
from drcli.rewards import course
from drcli.rewards.course import ScriptedDriver
from drcli.rewards.reward_parameter_texts import REWARD_PARAMETERS
from drsim.episode.simulation import Simulation
from drsim.track.worlds import load_track


def kinds(question: str) -> list[str]:
    return [entry.kind for entry in explain(question)]


def test_every_hyperparameter_column_code_and_parameter_is_explained():
    assert set(KEYS) <= set(TEXTS)
    assert set(CSV_HEADER.split(",")) == set(TRACE_COLUMNS)
    assert {entry.name for entry in every_entry() if entry.kind == "setting"} == set(catalogue())
    assert {entry.name for entry in every_entry() if entry.kind == "exit code"} == {
        str(code) for code in EXIT_CODES
    }


def test_every_parameter_that_a_reward_function_gets_is_explained():
    seen: set[str] = set()

    def note(params: dict[str, Any]) -> float:
        seen.update(params)
        return 1.0

    track = load_track("reinvent_base")
    simulation = Simulation(track, num_cars=1, reward_function=note, num_threads=1)
    simulation.reset(np.array([0]), np.array([0.0]))
    simulation.step(np.array([0.0]), np.array([1.0]))
    simulation.close()

    assert seen == set(REWARD_PARAMETERS)


def test_a_setting_is_found_by_its_old_name_too():
    assert [entry.name for entry in explain("DR_TRAIN_STOP_REWARD")] == ["DR_TRAIN_STOP_MEAN_SCORE"]


@pytest.mark.parametrize("key", KEYS)
def test_a_hyperparameter_says_what_a_change_costs_and_what_is_shipped(key):
    entry = explain(key)[0]
    labels = {detail.label: detail.text for detail in entry.details}

    assert entry.kind == "hyperparameter"
    assert labels["Advice"]
    assert (
        labels.get("Higher")
        or labels.get("Effect")
        or key == "term_cond_avg_score"
        or (key == "term_cond_max_episodes")
    )
    if key in shipped_values():
        assert labels["Shipped value"].casefold() == str(shipped_values()[key]).casefold()


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("lr", "0.0003"),
        ("term_cond_avg_score", "100000"),
        ("clip_value", "off"),
        ("bootstrap_cut", "false"),
        ("sac_tau", "0.02"),
        ("sac_n_step", "5"),
        ("sac_updates_per_step", "0.5, or 1 on a GPU"),
    ],
)
def test_a_hyperparameter_that_is_left_out_has_the_value_that_a_training_takes(key, text):
    labels = {detail.label: detail.text for detail in explain(key)[0].details}

    assert labels["If left out"] == text


def test_texts_about_hyperparameters_name_settings_as_they_are_called_now():
    texts = [text for key in TEXTS.values() for text in astuple(key)]
    named = set(re.findall(r"DR_[A-Z_]+", " ".join(texts)))

    assert named
    assert named <= set(catalogue())


@pytest.mark.parametrize(
    ("question", "name", "kind"),
    [
        ("Discount Factor", "discount_factor", "hyperparameter"),
        ("LR", "lr", "hyperparameter"),
        ("dr_workers", "DR_WORKERS", "setting"),
        ("workers", "DR_WORKERS", "setting"),
        ("experience-buffer", "experience buffer", "term"),
        ("`ppo`", "PPO", "term"),
        ("closest waypoints", "closest_waypoints", "reward parameter"),
        ("tstamp", "tstamp", "trace column"),
        ("75", "75", "exit code"),
        ("exit code 75", "75", "exit code"),
        ("found a LOCK file", "Found a lock file ..., waiting", "error text"),
        (
            "2020-01-01 INFO Found a lock file 12_Step-300.ckpt.lock, waiting",
            "Found a lock file ..., waiting",
            "error text",
        ),
    ],
)
def test_case_and_signs_do_not_matter(question, name, kind):
    assert (name, kind) in [(entry.name, entry.kind) for entry in explain(question)]


def test_a_word_with_several_meanings_has_all_of_them():
    meanings = ["term", "reward parameter", "trace column", "setting"]
    assert kinds("progress") == meanings


def test_a_part_of_a_name_finds_the_names_that_have_it():
    assert {entry.name for entry in explain("epsilon_st")} == {"epsilon_steps"}


@pytest.mark.parametrize(
    ("word", "names"),
    [
        ("epsilon", ["clip_range", "epsilon", "epsilon_steps"]),
        ("max iterations", ["term_cond_max_episodes", "DR_TRAIN_MAX_ITERATIONS"]),
        ("entropy", ["beta_entropy", "entropy", "entropy_schedule"]),
    ],
)
def test_a_word_of_other_programs_leads_to_all_that_it_may_mean(word, names):
    assert [entry.name for entry in explain(word)] == names


def test_a_hyperparameter_of_other_programs_is_found():
    assert {entry.name for entry in explain("learning_rate")} == {"lr"}


@pytest.mark.parametrize(
    ("question", "offer"),
    [("discont_factor", "discount_factor"), ("entrpy", "entropy"), ("DR_WORKRS", "DR_WORKERS")],
)
def test_an_unknown_word_is_refused_with_those_that_look_alike(question, offer):
    with pytest.raises(SettingsError) as refusal:
        explain(question)

    assert offer in refusal.value.remedy
    assert refusal.value.code == 3


@pytest.mark.parametrize("question", ["", "  ", "...", "\x00", "?" * 100_000, "a", "\ud800"])
def test_nonsense_is_refused_in_one_sentence(question):
    with pytest.raises(SettingsError) as refusal:
        explain(question)

    assert len(str(refusal.value)) < 120


@given(st.text(max_size=40))
def test_any_text_is_explained_or_refused(question):
    try:
        found = explain(question)
    except SettingsError:
        return
    assert found


def test_without_a_question_everything_is_listed():
    names = {entry.name for entry in Explanation.of(" ").entries}

    assert {"lr", "DR_WORKERS", "entropy", "75"} <= names


def test_words_are_in_the_order_of_the_alphabet():
    names = [name.casefold() for name in GLOSSARY]

    assert names == sorted(names)


PRINTED, CHECK = Path(drcli.__file__).parent, "rewards/check.py"
CODE = re.compile(r"\b[A-Z]-[0-9]{2}\b")


def printed_names() -> set[str]:
    """Every code of a rule in our sources, every name of a finding, every subject of dr-doctor."""
    sources = [path.read_text("utf-8") for path in PRINTED.rglob("*.py")]
    codes = {code for text in sources for code in CODE.findall(text)}
    advice = {
        name
        for path in (PRINTED / "analysis" / "findings").glob("*.py")
        for name in re.findall(r'\bAdvice\(\s*"([a-z-]+)"', path.read_text("utf-8"))
    }
    tried = re.findall(r'\.(?:warning|note)\(\s*"([a-z-]+)"', (PRINTED / CHECK).read_text("utf-8"))
    examined = {
        subject
        for path in (PRINTED / "checks" / "doctor").glob("*.py")
        for subject in re.findall(r'\b(?:Finding|Probe)\(\s*"([\w ]+)"', path.read_text("utf-8"))
    }
    assert len(examined) > 15
    return codes | advice | set(tried) | set(typing.get_args(verdict.Kind)) | examined


def chosen_names() -> set[str]:
    """Every word that a setting, a model's file or --checkpoint takes, and every driver."""
    drivers = {each.name for each in vars(course).values() if isinstance(each, ScriptedDriver)}
    choices = {word for each in catalogue().values() for word in each.choices}
    words = {*typing.get_args(CheckpointWord), *typing.get_args(Network), *SENSORS}
    return drivers | choices | words


@pytest.mark.parametrize("word", sorted(chosen_names()))
def test_every_word_that_can_be_chosen_is_explained(word):
    assert explain(word)


@pytest.mark.parametrize("name", sorted(printed_names()))
def test_every_code_and_name_that_is_printed_is_explained(name):
    assert any(entry.name.casefold() == name.casefold() for entry in explain(name))


@pytest.mark.parametrize(
    "words",
    [
        *["RTF", "sim2real", "overfitting", "snaking", "leaderboard", "free tier", "V-05"],
        *["eval", "median", "loss p/v", "steps/s", "machine hours", "submissions", "rollouts"],
        *["SIM_TRACE_LOG", "limit", "queue", "lap complete", "best average of 3 laps"],
        *["out of memory", "unrecognized runtime", "cancels-out"],
    ],
)
def test_the_words_of_the_community_are_explained(words):
    assert explain(words)
