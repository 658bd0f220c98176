"""hyperparameters.json: what is accepted, what is refused, and in which words."""

import contextlib
import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drcli.base.errors import SettingsError
from drcli.learn.algorithms import ALGORITHMS
from drcli.model.files.hyperparameters import KEYS, REFERENCE_KEYS, SYNONYMS, Hyperparameters

ROOT = Path(__file__).resolve().parents[4]
EXAMPLE = (ROOT / "defaults" / "hyperparameters.json").read_bytes()


def test_missing_keys_have_the_defaults_of_the_reference():
    values = Hyperparameters.from_bytes(b"{}")

    assert values == Hyperparameters()
    assert (values.num_epochs, values.discount_factor, values.huber) == (10, 0.999, False)


def test_the_example_of_the_project_is_accepted_without_a_warning():
    values = Hyperparameters.from_bytes(EXAMPLE)

    assert values.problems == ()
    assert values.huber


@pytest.mark.parametrize(
    ("algorithm", "keys"),
    [
        ("clipped_ppo", set(REFERENCE_KEYS) - {"sac_alpha"}),
        ("sac", set(REFERENCE_KEYS) - {"beta_entropy", "num_epochs"}),
    ],
)
def test_the_normalised_copy_holds_the_sorted_keys_of_its_algorithm(algorithm, keys):
    text = Hyperparameters.from_bytes(b'{"lr": 0.0001}').canonical_json(algorithm)

    assert list(json.loads(text)) == sorted(keys)
    assert len(keys) == (13 if algorithm == "clipped_ppo" else 12)
    assert '\n  "lr": 0.0001,\n' in text


def test_the_normalised_copy_reads_back_as_it_is():
    text = Hyperparameters.from_bytes(EXAMPLE).canonical_json()

    assert Hyperparameters.from_bytes(text.encode()).canonical_json() == text


def test_the_normalised_copy_of_a_reference_run_is_the_same_byte_by_byte():
    path = ROOT.parent / "shared/reference-runs/drfc-time-trial/ip/hyperparameters.json"
    if not path.exists():
        pytest.skip("the reference runs are not beside this checkout")

    text = Hyperparameters.from_bytes(path.read_bytes()).canonical_json()

    assert text == path.read_text("utf-8").strip()


@pytest.mark.parametrize(
    ("written", "huber"),
    [("Huber", True), ("mean squared error", False), ("mean_squared_error", False)],
)
def test_a_loss_is_recognised_in_every_spelling_in_use(written, huber):
    values = Hyperparameters.from_bytes(json.dumps({"loss_type": written}).encode())

    assert values.huber is huber
    assert values.loss_type in ("huber", "mean squared error")


def test_a_whole_number_may_be_written_with_a_point():
    values = Hyperparameters.from_bytes(b'{"term_cond_max_episodes": 1000.0, "lr": 0.001}')

    assert values.canonical_json().count(": 1000,") + values.canonical_json().count(": 1000\n") == 1


@pytest.mark.parametrize(
    ("line", "sentence", "remedy"),
    [
        (
            '"batch_size": "64"',
            'batch_size="64" is not a number',
            'Write 64 without quotes, as in "batch_size": 64.',
        ),
        ('"lr": "0,001"', 'lr="0,001" is not a number', "Write 0.001, with a point, as in"),
        ('"lr": "small"', 'lr="small" is not a number', 'Write a number, as in "lr"'),
        ('"num_epochs": true', "num_epochs=true is not a number", "Write a number, as"),
        ('"num_epochs": null', "num_epochs=null is not a number", "Write a number, as"),
        ('"num_epochs": 0', "num_epochs=0 is below 1", 'Write 1 or more, as in "num_epochs": 10.'),
        ('"stack_size": 1.5', "stack_size=1.5 is not a whole number", "Write a whole number"),
        ('"lr": 1.5', "lr=1.5 is above 1", "Write 1 or less"),
        ('"lr": 0', "lr=0 is below 1e-08", "Write 1e-08 or more"),
        ('"beta_entropy": -0.1', "beta_entropy=-0.1 is below 0", "Write 0 or more"),
        ('"discount_factor": 1.01', "discount_factor=1.01 is above 1", "Write 1 or less"),
        (
            '"num_episodes_between_training": 10001',
            "num_episodes_between_training=10001 is above 10000",
            "Write 10000 or less",
        ),
        ('"epsilon_steps": 1e999', "epsilon_steps=Infinity is far too large", "Write a number"),
        ('"loss_type": 3', "loss_type=3 is not one of huber, mean squared error", "Write one of"),
        (
            '"exploration_type": "random"',
            'exploration_type="random" is not one of categorical, e-greedy, additive_noise',
            "Write one of these.",
        ),
    ],
)
def test_a_bad_value_is_named_with_file_line_key_value_and_remedy(line, sentence, remedy):
    with pytest.raises(SettingsError) as refusal:
        Hyperparameters.from_bytes(
            f'{{\n  "e_greedy_value": 0.1,\n  {line}\n}}\n'.encode(), "h.json"
        )

    assert str(refusal.value) == f"h.json line 3: {sentence}."
    assert remedy in refusal.value.remedy


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "h.json: The file is empty."),
        ("[1]", "h.json line 1: The file contains [1] instead of a JSON object."),
        (
            '{\n"lr": 0.001,\n}',
            "h.json line 3: The file is not valid JSON at column 1: "
            "a key in double quotes is missing, "
            'as in "lr": 0.0003, or there is a comma too many.',
        ),
        (
            '{\n"lr": 0.001\n"stack_size": 1}',
            "h.json line 3: The file is not valid JSON at column 1: "
            "a comma or a closing bracket is "
            "missing.",
        ),
        (
            '{"lr" 0.001}',
            "h.json line 1: The file is not valid JSON at column 7: a : is missing after the key.",
        ),
        ('{"lr": }', "h.json line 1: The file is not valid JSON at column 8: a value is missing."),
        (
            '{"lr": NaN}',
            "h.json line 1: The file is not valid JSON: NaN is not a number in JSON.",
        ),
        (
            '{"lr": "x}',
            "h.json line 1: The file is not valid JSON at column 8: "
            "a text in quotes is not complete.",
        ),
        (
            '{"lr": 0.001, "lr": 0.0001}',
            "h.json line 1: The file is not valid JSON: the key lr occurs twice.",
        ),
        (
            "{} {}",
            "h.json line 1: The file is not valid JSON at column 4: "
            "there is something after the end.",
        ),
        (
            "{'lr': 1}",
            "h.json line 1: The file is not valid JSON at column 2: "
            "a key in double quotes is missing, "
            'as in "lr": 0.0003, or there is a comma too many.',
        ),
        (
            '{\n"lr": 0.001, // smaller later\n"stack_size": 1}',
            "h.json line 2: The file is not valid JSON at column 14: JSON has no comments.",
        ),
        (
            '{"lr": 0.001 # smaller later\n}',
            "h.json line 1: The file is not valid JSON at column 14: JSON has no comments.",
        ),
        (
            "/* mine */ {}",
            "h.json line 1: The file is not valid JSON at column 1: JSON has no comments.",
        ),
        ('{"a":' * 5000, "h.json: The file is nested too deeply."),
        (
            '{"lr": ' + "9" * 5000 + "}",
            "h.json: The file is not valid JSON: a number has too many digits.",
        ),
    ],
)
def test_broken_json_is_named_with_file_line_and_column(text, sentence):
    with pytest.raises(SettingsError) as refusal:
        Hyperparameters.from_bytes(text.encode(), "h.json")

    assert str(refusal.value) == sentence
    assert refusal.value.remedy


def test_a_value_is_told_in_the_letters_it_was_written_in():
    with pytest.raises(SettingsError, match='exploration_type="größe" is not one of'):
        Hyperparameters.from_bytes('{"exploration_type": "größe"}'.encode())


def test_everything_wrong_is_reported_at_once():
    with pytest.raises(SettingsError) as refusal:
        Hyperparameters.from_bytes(b'{"lr": 2,\n"num_epoch": 3,\n"stack_size": 0}')

    assert len(str(refusal.value).splitlines()) == 2
    assert [each.key for each in refusal.value.problems] == ["lr", "stack_size", "num_epoch"]


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("learning_rate", "lr"),
        ("Learning Rate", "lr"),
        ("entropy_coefficient", "beta_entropy"),
        ("epsilon", "clip_range"),
        ("clip-epsilon", "clip_range"),
        ("gamma", "discount_factor"),
        ("minibatch_size", "batch_size"),
        ("n_epochs", "num_epochs"),
        ("batchsize", "batch_size"),
        ("num_epoch", "num_epochs"),
    ],
)
def test_an_unknown_key_is_a_warning_that_names_what_is_meant(key, meant):
    [problem] = Hyperparameters.from_bytes(json.dumps({key: 0.5}).encode()).problems

    assert (problem.rule, problem.severity) == ("V-04", "warning")
    assert f"{key}=0.5 is not a hyperparameter" in problem.message
    assert problem.remedy == f"Did you mean {meant}? Correct the key, or remove the line."


def test_a_key_that_resembles_none_gets_no_guess():
    [problem] = Hyperparameters.from_bytes(b'{"reward_scale": 2}').problems

    assert problem.remedy.startswith("Remove the line; the keys are batch_size, ")


def test_a_key_that_a_command_chose_must_be_known():
    with pytest.raises(SettingsError, match=r"learning_rate=0\.1 is not a hyperparameter"):
        Hyperparameters.from_bytes(b'{"learning_rate": 0.1}', chosen=["learning_rate"])


def test_every_other_name_means_one_hyperparameter():
    others = [name for names in SYNONYMS.values() for name in names]

    assert len(others) == len(set(others))
    assert not set(others) & set(KEYS)
    assert set(SYNONYMS) <= set(KEYS)


@pytest.mark.parametrize(
    ("line", "warning"),
    [
        ('"lr": 0.01', "lr=0.01 is above 0.001, the most that the console takes."),
        (
            '"num_episodes_between_training": 200',
            "num_episodes_between_training=200 is above 100, the most that the console takes.",
        ),
        (
            '"loss_type": "hubr"',
            'loss_type="hubr" is read as mean squared error, as in the reference.',
        ),
        ('"batch_size": 34', "batch_size=34 is used as it is; 32 is probably meant."),
        ('"batch_size": 100', "batch_size=100 is unusual; common are 32, 64, 128, 256, 512."),
        ('"num_epochs": 1', "num_epochs=1 is unusual; common are 3 to 10."),
        (
            '"term_cond_avg_score": 500.0',
            "term_cond_avg_score=500 has no effect, as in other trainers.",
        ),
        (
            '"term_cond_max_episodes": 12',
            "term_cond_max_episodes=12 ends the training after so many iterations; despite its "
            "name the key counts iterations, as in other trainers.",
        ),
        (
            '"stack_size": 2',
            "stack_size=2 shows the network 2 frames at a time; other trainers ignore this key, "
            "and the physical car drives with a single frame only.",
        ),
        ('"discount_factor": 1', "discount_factor=1 looks ahead without end; 0.999 is usual."),
        (
            '"max_sample_count": 5',
            "max_sample_count is for the reference's trainer and does nothing here.",
        ),
    ],
)
def test_an_unusual_value_is_used_with_a_warning(line, warning):
    values = Hyperparameters.from_bytes(f"{{\n{line}}}".encode(), "h.json")

    assert [str(each) for each in values.problems] == [f"h.json line 2: {warning}"]


@pytest.mark.parametrize(
    ("kind", "algorithm", "continuous", "fits"),
    [
        ("categorical", "clipped_ppo", False, True),
        ("categorical", "clipped_ppo", True, True),
        ("e-greedy", "clipped_ppo", False, True),
        ("e-greedy", "clipped_ppo", True, False),
        ("additive_noise", "clipped_ppo", True, False),
        ("additive_noise", "sac", True, True),
        ("categorical", "sac", True, True),
        ("e-greedy", "sac", True, False),
    ],
)
def test_an_exploration_that_does_not_fit_the_model_is_explained(kind, algorithm, continuous, fits):
    values = Hyperparameters.from_bytes(json.dumps({"exploration_type": kind}).encode())

    conflict = values.conflict(ALGORITHMS[algorithm], continuous=continuous)

    assert (conflict is None) is fits
    assert fits or conflict.startswith(f"exploration_type={kind} ")


def test_keys_of_our_own_are_copied_only_where_they_change_something():
    values = Hyperparameters.from_bytes(
        b'{"clip_range": 0.2, "target_kl": 0.02, "max_grad_norm": null, "bootstrap_cut": true}'
    )

    copied = json.loads(values.canonical_json())

    assert set(copied) - set(REFERENCE_KEYS) == {"target_kl", "bootstrap_cut"}


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ('"bootstrap_cut": 1', "is neither true nor false"),
        ('"target_kl": 0', "is below 1e-06"),
        ('"lr_schedule": "cosine"', "is not one of constant, linear"),
        ('"critic": true', "is not one of camera, state"),
        ('"sac_tau": "0.01"', "is not a number"),
        ('"sac_n_step": 0', "is below 1"),
        ('"sac_n_step": 101', "is above 100"),
        ('"sac_n_step": 2.5', "is not a whole number"),
    ],
)
def test_a_wrong_value_of_our_own_keys_is_refused(line, problem):
    with pytest.raises(SettingsError, match=problem):
        Hyperparameters.from_bytes(f"{{{line}}}".encode())


def test_both_ends_of_the_fractions_are_legal():
    values = Hyperparameters.from_bytes(b'{"discount_factor": 1, "beta_entropy": 0}')

    assert (values.discount_factor, values.beta_entropy) == (1.0, 0.0)


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_file_is_read_or_refused_and_nothing_else(data):
    at = data.draw(st.integers(0, len(EXAMPLE)))
    junk = data.draw(st.binary(max_size=4) | st.sampled_from([b'"', b"{", b"[", b"1e9", b"null,"]))
    text = EXAMPLE[:at] + junk + EXAMPLE[at + data.draw(st.integers(0, 20)) :]

    with contextlib.suppress(SettingsError):
        values = Hyperparameters.from_bytes(text)

        assert Hyperparameters.from_bytes(values.canonical_json().encode()).lr == values.lr
